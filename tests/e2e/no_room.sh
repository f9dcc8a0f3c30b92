#!/usr/bin/env bash
# usage: no_room.sh BIN
# Where the disk is full, or a file may not grow, an upload fails with the reason and leaves nothing behind, and the
# server lives on. Exit code 77 where no disk can be mounted, once all else has passed.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"

# 8 MB of vertices and a triangle.
awk 'BEGIN { for (i = 0; i < 200000; ++i) printf "v %d.%06d %d.5 %d.25\n", i, i, i % 777, i % 991; print "f 1 2 3" }' \
  >"$scratch/large.obj"
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' >"$scratch/small.obj"

# check_full REASON: a small mesh finds room, a large one does not.
check_full() {
  start_server
  expect 0 client upload --name small "$scratch/small.obj"
  expect 72 client upload --name large "$scratch/large.obj"
  expect_text "$scratch/err" "$1"
  expect 69 client show large
  expect 0 client upload --name again "$scratch/small.obj"
  echo 0.25,0.25,1,0,0,-1 >"$scratch/rays.csv"
  expect 0 client cast small "$scratch/rays.csv"
  stop_server
}

# The limit would end the server by SIGXFSZ, were the signal not ignored.
limit=$(ulimit -S -f)
ulimit -S -f 2048
check_full 'file size limit'
ulimit -S -f "$limit"
rm -rf "$data"

# A tmpfs that nobody but the server sees, and that goes with it.
mkdir "$data"
launcher=(unshare --map-root-user --mount bash -c 'mount -t tmpfs -o size=2m none "$0" && exec "$@"' "$data")
if "${launcher[@]}" true 2>/dev/null; then
  check_full 'disk full'
else
  echo "SKIPPED: no disk was filled, since this system lets nobody mount one"
  exit 77
fi
