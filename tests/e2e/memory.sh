#!/usr/bin/env bash
# usage: memory.sh BIN
# Meshes of five times the memory that their trees may take: all are answered, in turn, and the server's memory stays
# under the limit and what it takes without any mesh.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"
bunny=/usr/share/glmark2/models/bunny.obj
need_file "$bunny" glmark2-data
libraries=$(ldd "$bin/deltarayd")
[[ ! "$libraries" =~ asan|tsan ]] || { echo "SKIPPED: sanitizers take memory of their own"; exit 77; }
# Beside the trees: what builds work in, as far as malloc has not given it back.
count=12 limit_kb=51200 beside_kb=65536

# memory FIELD: kilobytes, as the kernel counts them.
memory() { awk -v field="$1:" '$1 == field { print $2 }' "/proc/$server/status"; }

launcher=(env "DELTARAY_TREE_BYTES=${limit_kb}KB")
start_server
before=$(memory VmRSS)
echo 0,0,5,0,0,-1 >"$scratch/rays.csv"
for i in $(seq "$count"); do
  { cat "$bunny"; printf 'f 1 2 %d\n' $((i + 500)); } >"$scratch/bunny.obj"
  expect 0 client upload --name "bunny$i" "$scratch/bunny.obj"
done
for i in $(seq "$count") $(seq "$count"); do
  expect 0 client cast "bunny$i" "$scratch/rays.csv" --wait-final --format csv
  [ -s "$scratch/first" ] || cp "$scratch/out" "$scratch/first"
  cmp "$scratch/out" "$scratch/first" || fail "another answer from bunny$i"
done
dropped=$(grep -c 'to make room' "$scratch/server.log" || true)
[ "$dropped" -gt 0 ] || fail "no tree had to make room; the test proves nothing"
peak=$(memory VmHWM)
[ "$peak" -lt $((before + limit_kb + beside_kb)) ] || fail "$peak kB at the peak, $before before any mesh"
stop_server
echo "$count meshes, $dropped trees dropped: $before kB before, $peak kB at the peak, $limit_kb kB the limit"
