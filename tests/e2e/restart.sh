#!/usr/bin/env bash
# usage: restart.sh BIN
# A server that is told to end, or killed, in the middle of a stream, and is started again: the client goes on where it
# was, and writes what it would have written.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"
bunny=/usr/share/glmark2/models/bunny.obj
need_file "$bunny" glmark2-data

start_server
expect 0 client upload --name bunny "$bunny"
expect 0 client watch bunny
seq -f '%g,0.5,5,0,0,-1' -1 0.001 1 >"$scratch/line"
for _ in $(seq 200); do cat "$scratch/line"; done >"$scratch/rays"
expect 0 client cast bunny "$scratch/rays" --format raw
cp "$scratch/out" "$scratch/wanted"

for signal in TERM KILL; do
  # The rest of the rays comes once the server has gone, so that the stream is always in the middle then.
  mkfifo "$scratch/pipe"
  client cast bunny "$scratch/pipe" --format raw >"$scratch/hits" 2>"$scratch/err" &
  cast=$!
  exec 3>"$scratch/pipe"
  head -n 200000 "$scratch/rays" >&3
  if [ "$signal" = TERM ]; then stop_server; else crash_server; fi
  tail -n +200001 "$scratch/rays" >&3 &
  rest=$!
  exec 3>&-
  sleep 0.3
  start_server "$address"
  code=0
  wait "$cast" || code=$?
  wait "$rest" || fail "the client did not read all rays"
  [ "$code" -eq 0 ] || { cat "$scratch/err"; fail "exit code $code of a cast over SIG$signal"; }
  cmp "$scratch/wanted" "$scratch/hits" || fail "other hits over SIG$signal"
  rm "$scratch/pipe"
done
stop_server
