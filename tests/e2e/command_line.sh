#!/usr/bin/env bash
# usage: command_line.sh BIN
# Exit codes and messages that scripts rely on: 0, 1 local failure, 2 usage, 64 + gRPC code.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"

# expect_refused CODE COMMAND...: as expect, and standard error says why.
expect_refused() {
  expect "$@"
  [ -s "$scratch/err" ] || fail "no reason on standard error: ${*:2}"
}

start_server

expect_refused 2 timeout 20 "$bin/deltarayd" --no-such-flag
expect_refused 2 timeout 20 "$bin/deltarayd" --threads many
expect_refused 2 timeout 20 "$bin/deltarayd" --listen 127.0.0.1:99999 --data-dir "$scratch/other"
expect_text "$scratch/err" '0 to 65535'
# Open to other machines only where that is meant.
expect_refused 2 timeout 20 "$bin/deltarayd" --listen 0.0.0.0:0 --data-dir "$scratch/other"
expect_refused 1 timeout 20 "$bin/deltarayd" --listen "$address" --data-dir "$scratch/other"
expect_text "$scratch/err" "$address"
expect_refused 1 timeout 20 "$bin/deltarayd" --listen 127.0.0.1:0 --data-dir /dev/null/data
for flag in idle-timeout watchdog-interval drain-timeout; do
  expect_refused 2 timeout 20 "$bin/deltarayd" --listen 127.0.0.1:0 --data-dir "$scratch/other" "--$flag" nan
done
expect_refused 2 timeout 20 "$bin/deltarayd" --listen 127.0.0.1:0 --data-dir "$scratch/other" --token-file ''
expect_text "$scratch/err" 'token-file: is given, but empty'
expect_refused 2 env DELTARAY_TLS_CERT= timeout 20 "$bin/deltarayd" --listen 127.0.0.1:0 --data-dir "$scratch/other"
expect_refused 2 timeout 20 "$bin/deltarayd" --listen 127.0.0.1:0 --data-dir ''
expect_text "$scratch/err" 'data-dir: is given, but empty'
expect 0 "$bin/deltarayd" --help
expect_text "$scratch/out" 'Examples?:'

expect 0 client --help
# Longer than a server waits for a lock, which is 10 s.
expect_text "$scratch/out" '--timeout SECONDS.*=15$'
expect_refused 2 client
expect_refused 2 client no-such-command
expect_refused 2 client --timeout nan list
expect_refused 1 client --ca "$scratch" list
expect_refused 2 client upload
expect_refused 2 client cast mesh --columns nonsense
expect_refused 2 client render mesh --size 640 -o "$scratch/x.png"
for command in upload list show watch stats cast render delete; do
  expect 0 client "$command" --help
  expect_text "$scratch/out" 'Examples?:'
done

# Standard streams that are closed: nothing else takes their place.
with_closed_output() { "$@" >&-; }
with_closed_input() { "$@" <&-; }
with_full_output() { "$@" >/dev/full; }
expect_refused 1 with_closed_output client health
expect_text "$scratch/err" 'cannot write standard output: Bad file descriptor'
expect_refused 1 with_closed_input client upload -
expect_text "$scratch/err" 'cannot read standard input: Bad file descriptor'

for flag in --help --version; do
  expect_refused 1 with_full_output "$bin/deltarayd" "$flag"
  expect_text "$scratch/err" 'cannot write standard output: No space left on device'
done
expect_refused 1 timeout 20 "$bin/deltarayd" --listen 127.0.0.1:0 --data-dir "$scratch/other" --port-file "$scratch"
expect_text "$scratch/err" "cannot write $scratch: Is a directory"

expect_refused 1 client upload "$scratch/no-such-file.obj"
expect_refused 1 client cast mesh "$scratch/no-such-rays.csv"
expect_refused 67 client upload --format obj - <<<'f 1 2 3'
expect_text "$scratch/err" 'line 1'
expect_refused 69 client show no-such-mesh
expect_text "$scratch/err" 'no-such-mesh'
expect_refused 69 client delete no-such-mesh
stop_server
expect_refused 78 client --timeout 5 list
[ ! -s "$scratch/out" ] || fail "an error on standard output"
