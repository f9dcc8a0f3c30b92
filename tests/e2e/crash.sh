#!/usr/bin/env bash
# usage: crash.sh BIN
# SIGKILLs the server in mid-upload and shortly after: after each restart a mesh is there as a whole or not at all, those
# that were acknowledged give the same answers, and no other file is in the data directory.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"
bunny=/usr/share/glmark2/models/bunny.obj
need_file "$bunny" glmark2-data

# Rays in all directions, from a seeded walk on the sphere.
awk 'BEGIN { srand(7); for (i = 0; i < 2000; ++i) {
  z = 2 * rand() - 1; a = 6.2831853 * rand(); r = sqrt(1 - z * z); x = r * cos(a); y = r * sin(a)
  printf "%.6f,%.6f,%.6f,%.6f,%.6f,%.6f\n", 3 * x, 3 * y, 3 * z, -x + 0.1 * rand(), -y + 0.1 * rand(), -z } }' \
  >"$scratch/rays.csv"

# Two triangles and a bunny that stay; the mesh that gets lost is the bunny with one more triangle.
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n' >"$scratch/small.obj"
{ cat "$bunny"; printf 'f 1 500 1000\n'; } >"$scratch/other.obj"

# state: what a client can see of the meshes that must stay, and their files.
state() {
  for name in small bunny; do
    client show "$name" --format json | grep -o '"id": *"[0-9a-f]*"'
    client cast "$name" "$scratch/rays.csv" --wait-final --format csv
  done
}
files() { (cd "$data" && find . -type f | sort); }
ids() { client list --format json | grep -o '"id": *"[0-9a-f]*"' | grep -o '[0-9a-f]\{64\}' | sort; }
meshes() { ids | wc -l; }

start_server
expect 0 client upload --name small "$scratch/small.obj"
expect 0 client upload --name bunny "$bunny"
state >"$scratch/state.before"
grep -q ',1,0$' "$scratch/state.before" || fail "no ray hits anything; the comparison would prove nothing"
files >"$scratch/files.before"
ids >"$scratch/ids.before"

# Crash while the server waits for the rest of the file.
mkfifo "$scratch/pipe"
timeout 120 "$bin/deltaray" --server "$address" upload --name other --format obj - <"$scratch/pipe" \
  >"$scratch/upload.out" 2>"$scratch/upload.err" &
upload=$!
exec 9>"$scratch/pipe"
head -c 2000000 "$scratch/other.obj" >&9
sleep 1
kill -0 "$upload" || fail "the upload ended before its file did: $(cat "$scratch/upload.err")"
crash_server
exec 9>&-
code=0
wait "$upload" || code=$?
[ "$code" -eq 78 ] || fail "the client of a crashed server ended with $code, not UNAVAILABLE: $(cat "$scratch/upload.err")"

start_server
expect 69 client show other
[ "$(meshes)" -eq 2 ] || fail "$(meshes) meshes after the crash"
state | cmp - "$scratch/state.before" || fail "answers differ after the crash"
files | diff "$scratch/files.before" - || fail "files differ after the crash"

# Crash at other moments, as parts of the time that a whole upload takes: while the file is sent, read, checked, stored,
# acknowledged, built.
begin=$(date +%s%N)
expect 0 client upload --name other "$scratch/other.obj"
duration=$((($(date +%s%N) - begin) / 1000000))
expect 0 client delete other
whole=0
for percent in 20 50 70 80 90 100 110 150; do
  delay=$(printf '%d.%03d' $((duration * percent / 100000)) $((duration * percent / 100 % 1000)))
  client upload --name other "$scratch/other.obj" >/dev/null 2>&1 &
  upload=$!
  sleep "$delay"
  crash_server
  acknowledged=0
  wait "$upload" || acknowledged=$?
  start_server
  code=0
  client show other >/dev/null 2>&1 || code=$?
  case $code in
    0)
      whole=$((whole + 1))
      [ "$(meshes)" -eq 3 ] || fail "$(meshes) meshes, not 3, after a crash at $delay s"
      expect 0 client cast other "$scratch/rays.csv" --format csv
      ;;
    69) [ "$acknowledged" -ne 0 ] || fail "a mesh that was acknowledged is lost after a crash at $delay s" ;;
    *) fail "exit code $code for a mesh after a crash at $delay s" ;;
  esac
  state | cmp - "$scratch/state.before" || fail "answers differ after a crash at $delay s"
  # Where the crash came between the mesh and its name, the mesh is there without one.
  for id in $(ids | comm -13 "$scratch/ids.before" -); do expect 0 client delete "$id"; done
done
echo "$whole of 8 uploads were stored before the crash"
files | diff "$scratch/files.before" - || fail "files are left behind by the crashes"
stop_server
