#!/usr/bin/env bash
# usage: overload.sh [--minutes M] [--quick] [--bin BIN]
# Far more than the server can do: 256 streams with batches of up to the limit, and 64 more whose clients hardly read.
# Memory stays under the budgets, small calls and health checks are answered soon, nothing is answered wrongly, nothing
# fails but by documented refusals, and one stream is as fast as before within a second of the end.
#
# The load is put on by a process of low priority, so that it takes the processor neither from the server nor from the
# probe. What the machine adds to the probe's times is measured by it too ("own").
minutes=10 quick=
bin=$(dirname "${BASH_SOURCE[0]}")/../../build/bin
while [ $# -gt 0 ]; do
  case "$1" in
    --minutes) minutes=$2; shift ;;
    --quick) quick=1 ;;
    --bin) bin=$2; shift ;;
    *) echo "usage: overload.sh [--minutes M] [--quick] [--bin BIN]" >&2; exit 2 ;;
  esac
  shift
done
set -- "$bin"
source "$(dirname "${BASH_SOURCE[0]}")/../e2e/server.sh"

seconds=$((minutes * 60))
# Milliseconds, and parts.
max_p99=50 max_growth=1.15 min_recovery=0.7 speed_tries=1
# Half of the defaults, so that twice as many batches wait.
batch_mb=512 network_mb=512
load_flags=() load_nice=19
# The shorter run is for any machine: one that is slow or busy may take longer to come round to each stream, and would
# hardly run a load of the lowest priority, whose connections then are closed as those of clients that have died.
if [ -n "$quick" ]; then
  seconds=15 max_p99=150 speed_tries=5 batch_mb=256 network_mb=256
  load_flags=(--max-batch 131072 --longest 120) load_nice=5
fi
export DELTARAY_BATCH_BYTES="${batch_mb}MB" DELTARAY_NETWORK_BYTES="${network_mb}MB" DELTARAY_LOG_LEVEL=warning

torture() {
  timeout $((seconds + 120)) "$bin/deltaray_torture" "$1" --server "$address" "${@:2}"
}

# What the server takes of memory, in MB, now.
rss() {
  awk '/^VmRSS:/ { print int($2 / 1024) }' "/proc/$server/status"
}

start_server
speed_before=$(torture speed --seconds 2)
base=$(rss)
nice -n "$load_nice" "$bin/deltaray_torture" load --server "$address" --seconds "$seconds" "${load_flags[@]}" >"$scratch/load" 2>"$scratch/load_errors" &
load=$!
sleep 1
torture probe --seconds $((seconds - 2)) >"$scratch/probe" &
probe=$!
# Bounded by the load, which ends by itself.
while kill -0 "$load" 2>/dev/null; do
  rss >>"$scratch/rss" || break
  sleep 0.25
done
load_code=0 probe_code=0
wait "$load" || load_code=$?
wait "$probe" || probe_code=$?
sleep 0.5
recovered() { awk "BEGIN { exit !(${speed_after% *} >= $min_recovery * ${speed_before% *}) }"; }
# The shorter run tries again where the machine itself may have slowed down meanwhile.
for _ in $(seq "$speed_tries"); do
  speed_after=$(torture speed --seconds 2)
  ! recovered || break
done
stop_server

read -r first_peak peak < <(awk '{ x[NR] = $1 } END {
  for (i = 1; i <= NR; ++i) { if (i <= NR / 2 && x[i] > a) a = x[i]; if (x[i] > b) b = x[i] }
  print a, b }' "$scratch/rss")
number() {
  grep -oE "$1 p50 [0-9.]+ p99 [0-9.]+" "$scratch/probe" | grep -oE '[0-9.]+$'
}
cat "$scratch/load_errors" >&2
failed=
check() { # check TEXT AWK_CONDITION
  awk "BEGIN { exit !($2) }" || failed="$failed; $1"
}
[ "$load_code" -eq 0 ] || failed="$failed; the load failed"
[ "$probe_code" -eq 0 ] || failed="$failed; a small call failed"
check "memory over the budgets" "$peak <= $base + $batch_mb + $network_mb"
# The shorter run is over before the memory has settled.
[ -n "$quick" ] || check "memory grows" "$peak <= $first_peak * $max_growth"
# A machine that wakes the probe itself that late tells nothing of the server; the long run is for one that does not.
unjudged=
if [ -n "$quick" ] && [ "$probe_code" -eq 0 ] && awk "BEGIN { exit !($(number own) > 10) }"; then
  unjudged=" (times not judged: the machine is busy)"
fi
if [ "$probe_code" -eq 0 ] && [ -z "$unjudged" ]; then
  check "small calls are late" "$(number calls) <= $max_p99"
  check "health checks are late" "$(number health) <= $max_p99"
fi
recovered || failed="$failed; no full speed afterwards"
echo "overload, $seconds s: $(cat "$scratch/load"); $(cat "$scratch/probe"); memory $base MB before, $peak MB at most" \
  "(budgets $batch_mb + $network_mb MB); one stream $speed_before before, $speed_after after$unjudged${failed:+: FAILED$failed}"
[ -z "$failed" ]
