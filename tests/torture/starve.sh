#!/usr/bin/env bash
# usage: starve.sh [--quick] [--bin BIN] [--with-descriptors]
# A server without file descriptors, disk, memory or threads, and with clients that stop, die or never speak: it survives
# each, and answers as before once the want is over, without a restart.
# --quick is what it always is. --with-descriptors leaves out their want, which programs that are compiled with the
# undefined-behaviour sanitizer cannot bear: it takes two of them to look at a pointer.
want_descriptors=1
bin=$(dirname "${BASH_SOURCE[0]}")/../../build/bin
while [ $# -gt 0 ]; do
  case "$1" in
    --quick) shift ;;
    --bin) bin=$2; shift 2 ;;
    --with-descriptors) want_descriptors=; shift ;;
    *) echo "usage: starve.sh [--quick] [--bin BIN] [--with-descriptors]" >&2; exit 2 ;;
  esac
done
set -- "$bin"
source "$(dirname "${BASH_SOURCE[0]}")/../e2e/server.sh"

export DELTARAY_LOG_LEVEL=warning
survived=
tell() {
  survived="$survived${survived:+, }$1"
}

# A mesh of many triangles that takes some megabytes, and a small one.
awk 'BEGIN { for (i = 0; i < 100000; ++i) printf "v %d.%06d %d.5 %d.25\n", i, i, i % 777, i % 991; print "f 1 2 3" }' \
  >"$scratch/large.obj"
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' >"$scratch/small.obj"
# So many that they are for the threads that trace.
rays=1000
for i in $(seq "$rays"); do echo 0.25,0.25,1,0,0,-1; done >"$scratch/rays.csv"

torture() {
  timeout 120 "$bin/deltaray_torture" "$1" --server "$address" "${@:2}"
}

# works: the server does all that it is for, within ten seconds.
works() {
  local i
  for i in $(seq 20); do
    if { client upload --name small "$scratch/small.obj" && client cast small "$scratch/rays.csv"; } \
      >"$scratch/out" 2>"$scratch/err"; then
      [ "$(grep -cE '^[0-9]+,1,0,0\.25,0\.25,1,0$' "$scratch/out")" -eq "$rays" ] || fail "wrong hits after the want of $1"
      return
    fi
    sleep 0.5
  done
  cat "$scratch/err"
  fail "it does not recover from the want of $1"
}

# hold COUNT: opens so many connections that never speak; the numbers of their files are in $held.
hold() {
  held=()
  local i file
  for i in $(seq "$1"); do
    { exec {file}<>"/dev/tcp/${address%:*}/${address#*:}"; } 2>/dev/null || break
    held+=("$file")
  done
}

release() {
  local file
  for file in "${held[@]}"; do exec {file}>&-; done
}

limit=(prlimit --pid)

# --- file descriptors: more connections than there are numbers for
if [ -n "$want_descriptors" ]; then
  start_server
  works start
  count=$(ls "/proc/$server/fd" | wc -l)
  "${limit[@]}" "$server" --nofile=$((count + 20)):
  hold 100
  expect 78 client --timeout 2 list
  expect_text "$scratch/server.log" 'no file descriptors for new connections'
  release
  "${limit[@]}" "$server" --nofile=1024:
  works "file descriptors"
  tell "file descriptors (${#held[@]} connections)"
  stop_server
fi

# --- connections: those that never speak are closed, and do not shut out those that do
export DELTARAY_MAX_CONNECTIONS=50
start_server
works start
hold 100
printf 'PRI * HTTP/2.0\r\n' >&"${held[0]}" # and one that stops within its greeting
expect 78 client list
sleep 11
works "connections"
tell "half-open connections (${#held[@]}, limit 50)"
release
stop_server
unset DELTARAY_MAX_CONNECTIONS

# --- disk: files may not grow
start_server
"${limit[@]}" "$server" --fsize=65536:
expect 72 client upload --name large "$scratch/large.obj"
"${limit[@]}" "$server" --fsize=unlimited:
works disk
tell disk
expect 0 client upload --name large "$scratch/large.obj"

# --- stopped and killed clients
"$bin/deltaray_torture" load --server "$address" --seconds 60 --streams 32 --slow 0 >/dev/null 2>&1 &
stopped=$!
"$bin/deltaray_torture" load --server "$address" --seconds 60 --streams 32 --slow 0 >/dev/null 2>&1 &
killed=$!
sleep 4
kill -STOP "$stopped"
kill -KILL "$killed"
works "clients that stop and die"
speed=$(torture speed --seconds 1)
kill -KILL "$stopped"
wait "$stopped" "$killed" 2>/dev/null || true
works "clients that stop and die"
tell "clients stopped and killed ($speed beside 32 stopped streams)"
stop_server

# --- memory: what it has at first, the two budgets, and a little for all else. Libraries below end a process that gets
# no memory at all, so that the budgets are what has to hold.
export DELTARAY_MAX_MESSAGE_BYTES=8MB DELTARAY_BATCH_BYTES=64MB DELTARAY_NETWORK_BYTES=256MB
# The address sanitizer would keep 256 MB of what is freed.
export ASAN_OPTIONS="${ASAN_OPTIONS:+$ASAN_OPTIONS:}quarantine_size_mb=16"
start_server
torture speed --seconds 0.5 >/dev/null
data_kb=$(awk '/^VmData:/ { print $2 }' "/proc/$server/status")
"${limit[@]}" "$server" --data=$(((data_kb << 10) + (512 << 20))):
torture load --seconds 5 --longest 60 --streams 64 --slow 16 --max-batch 131072 >"$scratch/load" 2>&1 ||
  { cat "$scratch/load"; fail "load beside a limit on memory"; }
works memory
tell "memory (budgets of 64 + 256 MB, limit 512 MB; $(cat "$scratch/load"))"
stop_server
unset DELTARAY_MAX_MESSAGE_BYTES DELTARAY_BATCH_BYTES DELTARAY_NETWORK_BYTES

# --- threads: none beyond those that it starts with. The limit is on all of a user's; root, who has none, lets nobody
# run the server.
if [ "$(id -u)" -eq 0 ]; then
  launcher=(setpriv --reuid nobody --regid nogroup --clear-groups)
  chown -R nobody "$scratch"
fi
if "${launcher[@]}" test -x "$bin/deltarayd"; then
  start_server
  limit=("${launcher[@]}" "${limit[@]}")
  threads=$("${limit[@]}" "$server" --nproc --output SOFT --noheadings)
  "${limit[@]}" "$server" --nproc=1:
  torture load --seconds 3 --streams 16 --slow 4 >/dev/null 2>&1 || true
  kill -0 "$server" 2>/dev/null || fail "the want of threads ended the server: $(cat "$scratch/server.log")"
  expect_text "$scratch/server.log" 'no thread to build with'
  "${limit[@]}" "$server" --nproc="$threads":
  works threads
  tell threads
  # It drains without a thread to be had.
  "${limit[@]}" "$server" --nproc=1:
  # gRPC counts the thread for timers that it could not start, and waits for its end when all else has ended.
  stop_server 3
else
  echo "SKIPPED: threads were not taken away, since nobody but root may run $bin/deltarayd"
fi
echo "starved, and recovered without a restart, of: $survived"
