#!/usr/bin/env bash
# usage: security.sh BIN
# TLS, mutual TLS and tokens with real certificates: who gets in, what the others are told, certificates and tokens that
# change while a stream runs, and flags that are refused.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"
command -v openssl >/dev/null || { echo "SKIPPED: openssl is missing"; exit 77; }
certs="$scratch/certs"
mkdir "$certs"
bash "$(dirname "${BASH_SOURCE[0]}")/../certificates.sh" "$certs"
read_token=$(openssl rand -hex 32)
write_token=$(openssl rand -hex 32)

# refused CODE PATTERN COMMAND...: as expect, and standard error matches the pattern.
refused() {
  expect "$1" "${@:3}"
  expect_text "$scratch/err" "$2"
}
digest() { printf %s "$1" | sha256sum | cut -d ' ' -f 1; }
with_token() { DELTARAY_TOKEN=$1 client "${@:2}"; }
# server_with NAME=VALUE...: starts the server with these variables.
server_with() { launcher=(env "$@"); start_server; }
# wait_for_log PATTERN LINES: until so many lines of the log match.
wait_for_log() {
  local i
  for i in $(seq 200); do
    [ "$(grep -cE -- "$1" "$scratch/server.log")" -lt "$2" ] || return 0
    sleep 0.1
  done
  fail "the log has not $2 lines that match '$1'"
}
# serial: that of the certificate that the server shows now.
serial() {
  openssl s_client -connect "$address" -alpn h2 -CAfile "$certs/ca.pem" </dev/null 2>/dev/null | openssl x509 -noout -serial
}
# speaks ADDRESS VERSION: whether a handshake of this version of TLS succeeds there. At its usual security level s_client
# would refuse the old ones itself.
speaks() {
  openssl s_client "$2" -cipher ALL:@SECLEVEL=0 -connect "$1" -alpn h2 </dev/null >/dev/null 2>&1
}
echo 'v 0 0 0 v 1 0 0 v 0 1 0' | sed 's/ v /\nv /g' >"$scratch/triangle.obj"
echo 'f 1 2 3' >>"$scratch/triangle.obj"
ray=0.25,0.25,1,0,0,-1

# --- Flags that are refused, and files that are of no use
deltarayd() { timeout 20 "$bin/deltarayd" --data-dir "$scratch/other" "$@"; }
refused 2 '--tls-cert and --tls-key, or say --insecure-listen' deltarayd --listen 0.0.0.0:0
refused 2 'read tokens' deltarayd --listen 0.0.0.0:0 --token-file "$scratch/tokens"
refused 2 '--tls-key is missing' deltarayd --tls-cert "$certs/server.pem"
refused 2 '--tls-cert is missing' deltarayd --tls-key "$certs/server.key"
refused 2 '--tls-client-ca: --tls-cert' deltarayd --tls-client-ca "$certs/ca.pem"
tls() { deltarayd --listen 127.0.0.1:0 --tls-cert "$1" --tls-key "$2" "${@:3}"; }
refused 1 "--tls-cert: $certs/none.pem: No such file" tls "$certs/none.pem" "$certs/server.key"
refused 1 "--tls-cert: $certs/server.key: holds no certificate" tls "$certs/server.key" "$certs/server.key"
refused 1 "--tls-key: $certs/server.pem: holds no private key" tls "$certs/server.pem" "$certs/server.pem"
refused 1 "--tls-key: $certs/renewed.key: is not the key of the first certificate in --tls-cert, $certs/server.pem" \
  tls "$certs/server.pem" "$certs/renewed.key"
refused 1 "--tls-cert: $certs/short.pem: is of no use to a server: .*too small" tls "$certs/short.pem" "$certs/short.key"
head -c 300 "$certs/server.pem" >"$certs/half.pem"
refused 1 "--tls-cert: $certs/half.pem: certificate 1 is damaged" tls "$certs/half.pem" "$certs/server.key"
openssl ec -in "$certs/server.key" -aes256 -passout pass:secret -out "$certs/locked.key" 2>/dev/null
refused 1 "--tls-key: $certs/locked.key: holds no private key in PEM without passphrase" tls "$certs/server.pem" "$certs/locked.key"
refused 1 "--tls-client-ca: $certs/ca.key: holds no certificate" tls "$certs/server.pem" "$certs/server.key" --tls-client-ca "$certs/ca.key"
refused 1 '--token-file: .*No such file' deltarayd --listen 127.0.0.1:0 --token-file "$scratch/none"
echo "# nobody" >"$scratch/tokens"
refused 1 "--token-file: $scratch/tokens: holds no token" deltarayd --listen 127.0.0.1:0 --token-file "$scratch/tokens"
echo "read $read_token x" >"$scratch/tokens"
refused 1 'line 1: .*SHA-256' deltarayd --listen 127.0.0.1:0 --token-file "$scratch/tokens"
! grep -q "$read_token" "$scratch/err" || fail "the log shows a token"

# --- TLS
show_certificate() {
  cp "$certs/$1.pem" "$scratch/now.pem"
  cp "$certs/$1.key" "$scratch/now.key"
}
show_certificate server
server_with DELTARAY_TLS_CERT="$scratch/now.pem" DELTARAY_TLS_KEY="$scratch/now.key"
expect 0 client --ca "$certs/ca.pem" upload "$scratch/triangle.obj" --name triangle
expect 0 client --ca "$certs/ca.pem" cast triangle --columns t <<<"$ray"
expect_text "$scratch/out" '^0,1$'
refused 78 'of no authority in --ca' client --ca "$certs/other-ca.pem" list
refused 78 'of no authority that this system knows; see --ca' client --tls list
refused 78 'speaks TLS: see --tls' client list
refused 1 "--ca: $certs/ca.key: holds no certificates" client --ca "$certs/ca.key" list
refused 1 '--ca: .*No such file' client --ca "$certs/none.pem" list
refused 2 '--key is missing' client --cert "$certs/client.pem" list
# Old versions are refused, and by the server: another one, which takes them, is spoken to.
timeout 60 openssl s_server -www -accept 127.0.0.1:0 -cert "$certs/server.pem" -key "$certs/server.key" \
  -min_protocol TLSv1 -cipher ALL:@SECLEVEL=0 </dev/null >"$scratch/lenient.log" 2>&1 &
lenient=$!
for _ in $(seq 200); do ! grep -q '^ACCEPT ' "$scratch/lenient.log" || break; sleep 0.1; done
for version in -tls1 -tls1_1; do
  speaks "$(sed -n 's/^ACCEPT //p' "$scratch/lenient.log")" "$version" || fail "s_client does not speak $version"
  ! speaks "$address" "$version" || fail "the server takes $version"
done
kill "$lenient"
for version in -tls1_2 -tls1_3; do
  speaks "$address" "$version" || fail "the server refuses $version"
done

# Certificates change while a stream runs. New ones that do not match, or are half written, are told in the log alone.
first=$(serial)
mkfifo "$scratch/rays"
client --ca "$certs/ca.pem" cast triangle --columns t --batch 1 - <"$scratch/rays" >"$scratch/hits" &
stream=$!
exec 9>"$scratch/rays"
echo "$ray" >&9
cp "$certs/renewed.pem" "$scratch/now.pem"
wait_for_log 'stays in use: --tls-key: .*is not the key' 1
[ "$(serial)" = "$first" ] || fail "the old certificate is not in use any more"
head -c 300 "$certs/renewed.pem" >"$scratch/now.pem"
wait_for_log 'stays in use: --tls-cert: .*damaged' 1
rm "$scratch/now.key"
wait_for_log 'stays in use: --tls-key: .*No such file' 1
[ "$(serial)" = "$first" ] || fail "the old certificate is not in use any more"
expect 0 client --ca "$certs/ca.pem" list
show_certificate renewed
wait_for_log 'read again, as they changed' 1
[ "$(serial)" != "$first" ] || fail "the new certificate is not in use"
expect 0 client --ca "$certs/ca.pem" list
echo "$ray" >&9
exec 9>&-
wait "$stream" || fail "the stream did not outlive the old certificate"
[ "$(grep -c ',1$' "$scratch/hits")" -eq 2 ] || fail "not two hits: $(cat "$scratch/hits")"

# Certificates that clients do not take
show_certificate elsewhere
wait_for_log 'read again, as they changed' 2
refused 78 'is not for 127.0.0.1' client --ca "$certs/ca.pem" list
show_certificate expired
wait_for_log 'read again, as they changed' 3
expect_text "$scratch/server.log" 'is not valid now'
refused 78 'not valid now .*expired' client --ca "$certs/ca.pem" list
stop_server

# --- Mutual TLS
cp "$certs/ca.pem" "$scratch/clients.pem"
server_with DELTARAY_TLS_CERT="$certs/server.pem" DELTARAY_TLS_KEY="$certs/server.key" DELTARAY_TLS_CLIENT_CA="$scratch/clients.pem"
as() { client --ca "$certs/ca.pem" --cert "$certs/$1.pem" --key "$certs/$1.key" "${@:2}"; }
expect 0 as client list
refused 78 'wants a certificate from its clients' client --ca "$certs/ca.pem" list
refused 78 'does not accept the certificate of --cert' as stranger list
refused 1 '--key: .*no private key of --cert' client --ca "$certs/ca.pem" --cert "$certs/client.pem" --key "$certs/server.key" list
refused 78 'speaks TLS' client list
cat "$certs/other-ca.pem" >"$scratch/clients.pem"
wait_for_log 'read again, as they changed' 4
expect 0 as stranger list
refused 78 'does not accept the certificate of --cert' as client list
stop_server

# --- Tokens
cat >"$scratch/tokens" <<EOF
# who may do what
read  $(digest "$read_token")  # looks
write $(digest "$write_token")
EOF
server_with DELTARAY_TOKEN_FILE="$scratch/tokens"
refused 80 'Bearer TOKEN' client list
# As the health check of a container, which has the server's variables.
expect 0 env DELTARAY_TOKEN_FILE="$scratch/tokens" "$bin/deltaray" --server "$address" health
refused 80 'not one that this server knows' with_token wrong list
refused 80 'not one that this server knows' with_token "$(digest "$read_token")" list
expect 0 with_token "$write_token" upload "$scratch/triangle.obj" --name triangle --wait
for command in "list" "show triangle" "watch triangle" "stats triangle" "chart triangle -o $scratch/x.svg --count 100"; do
  # shellcheck disable=SC2086 # words
  refused 80 UNAUTHENTICATED client $command
  # shellcheck disable=SC2086
  expect 0 with_token "$read_token" $command
done
expect 0 with_token "$read_token" cast triangle <<<"$ray"
refused 80 UNAUTHENTICATED client cast triangle <<<"$ray"
for command in "upload $scratch/triangle.obj" "name other triangle" "rebuild triangle" "delete triangle"; do
  # shellcheck disable=SC2086
  refused 80 UNAUTHENTICATED client $command
  # shellcheck disable=SC2086
  refused 71 "needs a token of the role 'write'" with_token "$read_token" $command
done
for command in "name other triangle" "rebuild triangle --wait" "delete triangle" "upload $scratch/triangle.obj --name triangle"; do
  # shellcheck disable=SC2086
  expect 0 with_token "$write_token" $command
done
printf '%s\n' "$read_token" >"$scratch/token"
expect 0 client --token-file "$scratch/token" list
expect 0 env DELTARAY_CLIENT_TOKEN_FILE="$scratch/token" "$bin/deltaray" --server "$address" list
refused 1 '--token-file: .*No such file' client --token-file "$scratch/none" list
refused 1 'printable ASCII' with_token $'a\nb' list
address_here=$address
address=192.0.2.1:7878
refused 2 'in plaintext: use --tls' with_token "$read_token" --timeout 2 list
address=$address_here

# Tokens change while a stream runs, which ends in peace; a bad new file changes nothing.
DELTARAY_TOKEN=$read_token client cast triangle --columns t --batch 1 - <"$scratch/rays" >"$scratch/hits" &
stream=$!
exec 9>"$scratch/rays"
echo "$ray" >&9
echo nonsense >"$scratch/tokens"
wait_for_log 'stays in use: --token-file: .*line 1' 1
expect 0 with_token "$read_token" list
refused 80 UNAUTHENTICATED client list
: >"$scratch/tokens"
wait_for_log 'stays in use: --token-file: .*holds no token' 1
refused 80 UNAUTHENTICATED client list
new_token=$(openssl rand -hex 32)
echo "read $(digest "$new_token")" >"$scratch/tokens"
wait_for_log 'read again, as they changed: .*tokens' 1
refused 80 'not one that this server knows' with_token "$read_token" list
refused 80 'not one that this server knows' with_token "$write_token" delete triangle
expect 0 with_token "$new_token" list
echo "$ray" >&9
exec 9>&-
wait "$stream" || fail "the stream did not outlive its token"
[ "$(grep -c ',1$' "$scratch/hits")" -eq 2 ] || fail "not two hits: $(cat "$scratch/hits")"
for token in "$read_token" "$write_token" "$new_token"; do
  ! grep -q "$token" "$scratch/server.log" || fail "the log shows a token"
done
stop_server

# --- Tokens over TLS
server_with DELTARAY_TLS_CERT="$certs/server.pem" DELTARAY_TLS_KEY="$certs/server.key" DELTARAY_TOKEN_FILE="$scratch/tokens"
expect 0 with_token "$new_token" --ca "$certs/ca.pem" list
refused 80 'Bearer TOKEN' client --ca "$certs/ca.pem" list
stop_server
