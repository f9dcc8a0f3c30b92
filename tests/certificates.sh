#!/usr/bin/env bash
# usage: certificates.sh DIRECTORY
# Makes what the tests of TLS need, with openssl: NAME.pem and NAME.key for each NAME below.
#   ca, other-ca     authorities
#   server, renewed  a server's, of ca, for localhost and 127.0.0.1
#   elsewhere        a server's, of ca, for elsewhere.example
#   expired          a server's, of ca, no longer valid
#   client           a client's, of ca
#   stranger         a client's, of other-ca
#   short            a server's, of ca, with a key that OpenSSL finds too short
set -euo pipefail
cd "$1"

# key NAME: makes NAME.key.
key() { openssl ecparam -name prime256v1 -genkey -noout -out "$1.key"; }

# authority NAME
authority() {
  key "$1"
  openssl req -x509 -new -key "$1.key" -subj "/CN=deltaray test $1" -days 2 -out "$1.pem" \
    -addext basicConstraints=critical,CA:TRUE -addext keyUsage=critical,keyCertSign,cRLSign
}

# signed NAME AUTHORITY ALTERNATIVE_NAMES [OPTION...]: signs NAME.key.
signed() {
  local name=$1 authority=$2 names=$3
  shift 3
  openssl req -new -key "$name.key" -subj "/CN=deltaray test $name" -out "$name.csr"
  openssl x509 -req -in "$name.csr" -CA "$authority.pem" -CAkey "$authority.key" -CAcreateserial -days 2 "$@" \
    -extfile <(printf 'basicConstraints=CA:FALSE\nsubjectAltName=%s\n' "$names") -out "$name.pem"
}

{
  authority ca
  authority other-ca
  for name in server renewed elsewhere expired client stranger; do key "$name"; done
  openssl genrsa -out short.key 512
  local_names=DNS:localhost,IP:127.0.0.1
  signed server ca $local_names
  signed renewed ca $local_names
  signed elsewhere ca DNS:elsewhere.example
  signed expired ca $local_names -days -1
  signed client ca DNS:client.example
  signed stranger other-ca DNS:stranger.example
  signed short ca $local_names
} >openssl.log 2>&1 || { cat openssl.log >&2; exit 1; }
