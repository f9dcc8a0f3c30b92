#!/usr/bin/env bash
# usage: history.sh [--seconds N] [--seed N] [--quick] [--bin BIN]
# Clients upload, rename, delete and trace the same few meshes, through one server and through three that share a
# directory, while servers are killed and started again, or stopped for a time, and connections are cut. Each answer must
# be that of brute force on a mesh that was live, or that the name led to, during the call; no batch of a stream may be
# lost, doubled or out of order.
set -euo pipefail

seconds=300
seed=$RANDOM
bin=$(dirname "${BASH_SOURCE[0]}")/../../build/bin
while [ $# -gt 0 ]; do
  case $1 in
    --seconds) seconds=$2; shift 2 ;;
    --seed) seed=$2; shift 2 ;;
    --quick) seconds=12; shift ;;
    --bin) bin=$2; shift 2 ;;
    *) echo "usage: history.sh [--seconds N] [--seed N] [--quick] [--bin BIN]"; exit 2 ;;
  esac
done

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
code=0
for servers in 1 3; do
  timeout $((180 + seconds)) "$bin/deltaray_torture" history --servers "$servers" --seconds "$seconds" --seed "$seed" \
    --directory "$scratch/$servers" >"$scratch/log.$servers" 2>&1 || code=1
  grep -v '^history:' "$scratch/log.$servers" || true
done
cat "$scratch"/log.* | grep '^history:' | paste -sd '|' | sed 's/|/; /g'
exit "$code"
