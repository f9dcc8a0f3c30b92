#!/usr/bin/env bash
# usage: quickstart.sh
# From a clone to a picture: installs what is missing, builds, starts a server on a free port of this machine, uploads
# the bunny, follows the build of its tree, casts the rays of a picture to ./bunny.png, and prints the statistics. The
# server and its data are gone when this ends, however it ends.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
mesh=/usr/share/glmark2/models/bunny.obj
picture=bunny.png

step() { printf '\n== %s\n' "$*"; }

step "Packages"
bash "$root/docker/install_packages.sh" build demo
echo "All packages are there."

step "Build"
cmake -S "$root" -B "$root/build" -DCMAKE_BUILD_TYPE=Release
cmake --build "$root/build" --parallel "$(nproc)" --target deltarayd deltaray
bin="$root/build/bin"

scratch=$(mktemp -d)
server=
finish() {
  local code=$?
  trap - EXIT
  if [ -n "$server" ] && kill -TERM "$server" 2>/dev/null; then
    timeout 20 tail --pid="$server" -f /dev/null || kill -KILL "$server" 2>/dev/null || true
  fi
  if [ "$code" -ne 0 ]; then
    echo "quickstart.sh: failed with exit code $code" >&2
    if [ -s "$scratch/server.log" ]; then
      echo "The server's last words:" >&2
      tail -n 20 "$scratch/server.log" >&2
    fi
  fi
  rm -rf "$scratch"
  exit "$code"
}
trap finish EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

step "Server"
mkdir "$scratch/data"
"$bin/deltarayd" --listen 127.0.0.1:0 --port-file "$scratch/port" --data-dir "$scratch/data" \
  >"$scratch/server.log" 2>&1 &
server=$!
for _ in $(seq 300); do
  [ ! -s "$scratch/port" ] || break
  kill -0 "$server" 2>/dev/null || { echo "the server did not start" >&2; exit 1; }
  sleep 0.1
done
[ -s "$scratch/port" ] || { echo "the server did not listen within 30 s" >&2; exit 1; }
address="127.0.0.1:$(cat "$scratch/port")"
echo "deltarayd listens on $address"
deltaray() { "$bin/deltaray" --server "$address" "$@"; }

step "Upload of $mesh"
deltaray upload --name bunny "$mesh"

step "Build of the tree"
deltaray watch bunny

step "Picture"
deltaray render bunny --size 640x480 --wait-final --output "$picture"

step "Build statistics"
deltaray stats bunny

step "Done: $PWD/$picture"
