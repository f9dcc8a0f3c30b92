# Sourced by the tests of this folder: starts and stops a real server, and asks it through the real client.
# $1 of the test is the directory of the two programs. All files go to $scratch, which is removed at the end.
set -euo pipefail

bin=$1
scratch=$(mktemp -d)
data="$scratch/data"
server=
address=
launcher=() # what the server is started with: a command that becomes it

finish() {
  local code=$?
  trap - EXIT
  [ -z "$server" ] || kill -KILL "$server" 2>/dev/null || true
  if [ "$code" -ne 0 ] && [ "$code" -ne 77 ]; then
    echo "--- the server's log"
    cat "$scratch"/server.log 2>/dev/null || true
  fi
  rm -rf "$scratch"
  exit "$code"
}
trap finish EXIT
trap 'exit 143' INT TERM

fail() {
  echo "FAILED: $*"
  exit 1
}

# need_file PATH PACKAGE: skips the test where the file is missing.
need_file() {
  [ -e "$1" ] || { echo "SKIPPED: $1 is missing; it comes with the package $2"; exit 77; }
}

# start_server [ADDRESS]: returns once the server listens, at any port where not told. Sets $server (process) and $address.
start_server() {
  rm -f "$scratch/port"
  "${launcher[@]}" "$bin/deltarayd" --listen "${1:-127.0.0.1:0}" --port-file "$scratch/port" --data-dir "$data" >>"$scratch/server.log" 2>&1 &
  server=$!
  local i
  for i in $(seq 600); do
    [ ! -s "$scratch/port" ] || break
    kill -0 "$server" 2>/dev/null || fail "the server did not start"
    sleep 0.1
  done
  [ -s "$scratch/port" ] || fail "the server did not listen within 60 s"
  address="127.0.0.1:$(cat "$scratch/port")"
}

# stop_server [OTHER_CODE]: SIGTERM; the server must end by itself with exit code 0, or OTHER_CODE. A sanitizer's report
# makes that code another.
stop_server() {
  local code=0
  kill -TERM "$server"
  timeout 60 tail -s 0.1 --pid="$server" -f /dev/null || fail "the server did not end within 60 s of SIGTERM"
  wait "$server" || code=$?
  server=
  [ "$code" -eq 0 ] || [ "$code" -eq "${1:-0}" ] || fail "the server ended with exit code $code after SIGTERM"
}

# crash_server: SIGKILL, as a power cut for the process.
crash_server() {
  kill -KILL "$server"
  wait "$server" 2>/dev/null || true
  server=
}

client() {
  timeout 120 "$bin/deltaray" --server "$address" "$@"
}

# expect CODE COMMAND...: runs it, with its streams in $scratch/out and $scratch/err; fails unless it ends with that code.
expect() {
  local want=$1 code=0
  shift
  "$@" >"$scratch/out" 2>"$scratch/err" || code=$?
  if [ "$code" -ne "$want" ]; then
    cat "$scratch/out" "$scratch/err"
    fail "exit code $code, not $want: $*"
  fi
}

# expect_text FILE PATTERN: fails unless a line of the file matches the extended regular expression.
expect_text() {
  grep -qE -- "$2" "$1" || { cat "$1"; fail "nothing in $1 matches '$2'"; }
}
