"""usage: http2_call.py HOST:PORT METHOD
Calls a method of gRPC with an empty message, over a connection of its own, and prints what no client of ours tells: the
settings of HTTP/2 that the server sends, and the call's status, as lines of `name value`.
"""

import socket
import struct
import sys

DATA, HEADERS, SETTINGS = 0, 1, 4
END_STREAM, END_HEADERS, ACK = 1, 4, 1
SETTING_NAMES = {3: "max_concurrent_streams", 6: "max_header_list_size"}


def frame(kind, flags, stream, payload):
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


def literal(name, value):
    """A header field that is in no table, of strings shorter than 127 bytes."""
    return b"\0" + b"".join(bytes([len(text)]) + text.encode() for text in (name, value))


def main():
    address, method = sys.argv[1:]
    host, port = address.rsplit(":", 1)
    fields = {":method": "POST", ":scheme": "http", ":path": method, ":authority": address, "te": "trailers",
              "content-type": "application/grpc"}
    with socket.create_connection((host, int(port)), timeout=30) as connection, connection.makefile("rb") as received:
        connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(SETTINGS, 0, 0, b"") +
                           frame(HEADERS, END_HEADERS, 1, b"".join(literal(*field) for field in fields.items())) +
                           frame(DATA, END_STREAM, 1, bytes(5)))
        while True:
            size, kind, flags, _ = struct.unpack(">IBBI", b"\0" + received.read(9))
            payload = received.read(size)
            if kind == SETTINGS and not flags & ACK:
                for setting, value in struct.iter_unpack(">HI", payload):
                    if setting in SETTING_NAMES:
                        print(SETTING_NAMES[setting], value)
            if kind == HEADERS and flags & END_STREAM:
                # gRPC compresses neither this name nor its value, which comes after its length.
                status = payload[payload.index(b"grpc-status") + len(b"grpc-status"):]
                print("status", status[1:1 + status[0]].decode())
                return


main()
