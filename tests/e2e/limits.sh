#!/usr/bin/env bash
# usage: limits.sh BIN
# Each limit of the server is the one that its flag gives: no two values are the same, and who goes beyond one is told the
# flag and its value. --tree-bytes has memory.sh, --batch-bytes, --network-bytes and --max-connections have tests/torture.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"

# start_limited FLAG...: starts the server with these flags.
start_limited() {
  flags=("$@")
  with_flags() { exec "$@" "${flags[@]}"; }
  launcher=(with_flags)
  start_server
}
# over VALUE FLAG COMMAND...: the command ends with RESOURCE_EXHAUSTED and names both.
over() {
  expect 72 "${@:3}"
  expect_text "$scratch/err" "(^|[^0-9])$1 [^(]*\(--$2\)"
}
# wait_for_calls METHOD COUNT: until so many are under way, by the server's metrics.
wait_for_calls() {
  local i
  for i in $(seq 200); do
    exec 3<>"/dev/tcp/127.0.0.1/$(sed -n 's/.*"metrics_port":\([0-9]*\).*/\1/p' "$scratch/server.log")"
    printf 'GET /metrics HTTP/1.0\r\n\r\n' >&3
    tr -d '\r' <&3 >"$scratch/page"
    exec 3>&-
    ! grep -q "^deltaray_calls_under_way{method=\"$1\"} $2\$" "$scratch/page" || return 0
    sleep 0.05
  done
  grep calls_under_way "$scratch/page" || true
  fail "not $2 calls of $1 within 10 s"
}
# told NAME VALUE METHOD: what the server tells of itself where a client of gRPC shows it to nobody.
told() {
  expect 0 /usr/bin/python3 "$(dirname "${BASH_SOURCE[0]}")/http2_call.py" "$address" "$3"
  expect_text "$scratch/out" "^$1 $2\$"
}
upload() { client upload --format obj - "$@"; }
# triangle HEIGHT: a mesh of its own.
triangle() { printf 'v 0 0 %d\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' "$1"; }
channelz=/grpc.channelz.v1.Channelz/GetServers

# --- Files and meshes
start_limited --max-upload-bytes 6001 --max-triangles 11 --max-vertices 13 --max-face-corners 7 --max-line-bytes 1025 \
  --max-groups 3 --max-group-name-bytes 9 --max-group-bytes 17 --max-stored-bytes 5003 --max-meshes 2 --max-names 5 \
  --max-names-per-mesh 4
vertices=$(printf 'v %d 0 0\n' $(seq 13))
over 11 max-triangles upload <<<"$vertices$(printf '\nf 1 2 3%.0s' $(seq 12))"
over 13 max-vertices upload <<<"$vertices"$'\nv 0 0 1'
over 7 max-face-corners upload <<<"$vertices"$'\nf 1 2 3 4 5 6 7 8'
over 1025 max-line-bytes upload <<<"#$(printf '%01025d' 0)"
groups() { printf '%s\n' "$vertices"; printf 'g %s\nf 1 2 3\n' "$@"; }
over 3 max-groups upload < <(groups a b c d)
over 9 max-group-name-bytes upload < <(groups 1234567890)
over 17 max-group-bytes upload < <(groups 123456789 987654321)
printf '%6002d' 0 >"$scratch/file"
over 6001 max-upload-bytes client upload "$scratch/file"
over 6001 max-upload-bytes upload <"$scratch/file"
printf '#%5003d' 0 >"$scratch/file"
over 5003 max-stored-bytes client upload "$scratch/file"

# At every limit, and beyond none.
{ groups 12345678 987654321; printf 'f 1 2 3 4 5 6 7\nf 1 2 3 4 5 6\n#%1024d\n' 0; } >"$scratch/most.obj"
expect 0 client upload --name a "$scratch/most.obj"
expect 0 upload --name b < <(triangle 0)
over 2 max-meshes upload --name c < <(triangle 1)
for name in c d e; do expect 0 client name "$name" a; done
over 4 max-names-per-mesh client name f a
over 5 max-names client name f b
told status 12 "$channelz"
expect_text "$scratch/server.log" '^[^{].* deltarayd starts'
stop_server

# --- Calls
rm -rf "$data" "$scratch/server.log"
start_limited --max-streams 2 --max-uploads 3 --max-calls 4 --max-connection-calls 7 --max-metadata-bytes 2049 \
  --max-batch-rays 501 --build-threads 3 --channelz --log-format json --metrics-listen 127.0.0.1:0 \
  --max-message-bytes 5MB --network-bytes 7MB --batch-bytes 9MB
# The log tells what is in force, where that is not what was given.
for sizes in max-group-bytes:$((5 << 18)) network-bytes:$((5 << 22)) batch-bytes:$((5 << 22)); do
  expect_text "$scratch/server.log" "\"deltarayd starts\".*\"${sizes%:*}\":\"${sizes#*:}\""
done
expect_text "$scratch/server.log" "\"listens\".*\"max_connections\":[0-9]+[,}]"
told max_concurrent_streams 7 "$channelz"
told max_header_list_size 2049 "$channelz"
told status 0 "$channelz"
expect 72 env DELTARAY_TOKEN="$(printf '%02049d' 0)" timeout 120 "$bin/deltaray" --server "$address" list
expect_text "$scratch/err" 'metadata size exceeds limit'
expect 0 upload --name a --wait < <(triangle 0)
expect 0 client stats a --format json
expect_text "$scratch/out" '"threads": ?3[,}]'
# cast RAYS: in one batch.
cast() { printf '0.2,0.2,1,0,0,-1\n%.0s' $(seq "$1") | client cast a --batch 1000 --columns t; }
expect 0 cast 501
over 501 max-batch-rays cast 502

# Calls that have begun, and go on once nobody holds $scratch/streams or $scratch/uploads open.
mkfifo "$scratch/streams" "$scratch/uploads"
held_stream() { { echo 0.2,0.2,1,0,0,-1; timeout 60 cat "$scratch/streams"; } | client cast a --batch 1 -; }
held_upload() { { timeout 60 cat "$scratch/uploads"; triangle 0; } | upload; }
held=()
# begin CALL: in the background.
begin() {
  "$1" >>"$scratch/held.log" 2>&1 8>&- 9>&- &
  held+=($!)
}
begin held_stream
begin held_stream
exec 8>"$scratch/streams"
wait_for_calls RayService/StreamRays 2
over 2 max-streams cast 1
begin held_upload
begin held_upload
exec 9>"$scratch/uploads"
wait_for_calls MeshService/UploadMesh 2
over 4 max-calls client list
exec 8>&-
wait "${held[0]}" && wait "${held[1]}" || { cat "$scratch/held.log"; fail "a stream within the limit was refused"; }
wait_for_calls RayService/StreamRays 0
begin held_upload
wait_for_calls MeshService/UploadMesh 3
over 3 max-uploads upload < <(triangle 0)
expect 0 client list
exec 9>&-
for call in "${held[@]:2}"; do
  wait "$call" || { cat "$scratch/held.log"; fail "an upload within the limit was refused"; }
done
! grep -qv '^{.*}$' "$scratch/server.log" || fail "the log is not of JSON alone"
stop_server

# --- Builds: two that last, and three behind them
rm -rf "$data" "$scratch/server.log"
start_limited --concurrent-builds 2 --max-queued-builds 3 --build-threads 1
for i in 1 2 3 4; do expect 0 upload --name "small$i" --wait < <(triangle "$i"); done
# large FACTOR: 300,000 triangles without order.
large() {
  awk -v factor="$1" 'BEGIN {
    for (i = 0; i < 300000; ++i) printf "v %d %d %d\n", i * 7919 % 10007, i * 104729 % 9973, i * factor % 9967
    for (i = 1; i < 299998; ++i) printf "f %d %d %d\n", i, i + 1, i + 2
  }'
}
for i in 31 37; do expect 0 upload --name "large$i" < <(large "$i"); done
for i in 31 37; do expect 0 client rebuild "large$i" --preset best --delta 4096; done # takes a thread many seconds
for i in 1 2 3; do expect 0 client rebuild "small$i"; done
over 3 max-queued-builds client rebuild small4
for i in 31 37; do expect 0 client delete "large$i"; done
for i in 1 2 3; do expect 0 client watch "small$i"; done
stop_server
