#!/usr/bin/env bash
# usage: crash.sh [--rounds N] [--seed N] [--quick] [--bin BIN]
# kill -9 at N random moments of uploads, renames, deletes, builds and queries: on one server, and on three that share a
# directory. Nothing that was acknowledged may be lost, and no file may be left that belongs to nothing.
set -euo pipefail

rounds=300
seed=$RANDOM
bin=$(dirname "${BASH_SOURCE[0]}")/../../build/bin
while [ $# -gt 0 ]; do
  case $1 in
    --rounds) rounds=$2; shift 2 ;;
    --seed) seed=$2; shift 2 ;;
    --quick) rounds=12; shift ;;
    --bin) bin=$2; shift 2 ;;
    *) echo "usage: crash.sh [--rounds N] [--seed N] [--quick] [--bin BIN]"; exit 2 ;;
  esac
done

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
code=0
for servers in 1 3; do
  timeout $((60 + rounds * 30)) "$bin/deltaray_torture" crash --servers "$servers" --rounds "$rounds" --seed "$seed" \
    --directory "$scratch/$servers" >"$scratch/log.$servers" 2>&1 || code=1
  grep -v '^crash:' "$scratch/log.$servers" || true
done
cat "$scratch"/log.* | grep '^crash:' | paste -sd '|' | sed 's/|/; /g'
exit "$code"
