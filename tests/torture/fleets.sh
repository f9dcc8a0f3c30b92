# Sourced by the scripts that fail servers one by one and three on a directory. `amount` is how much of what the script
# counts, `unit`, `quick` how much for --quick, `seconds_each` how long each may take at most.
set -euo pipefail

usage() {
  echo "usage: $(basename "$0") [--$unit N] [--seed N] [--quick] [--bin BIN]" >&2
  exit 2
}

# torture_fleets COMMAND ARGUMENT...
torture_fleets() {
  local command=$1 seed=$RANDOM bin code=0 servers scratch
  bin=$(dirname "${BASH_SOURCE[0]}")/../../build/bin
  shift
  while [ $# -gt 0 ]; do
    case $1 in
      "--$unit") amount=$2; shift 2 ;;
      --seed) seed=$2; shift 2 ;;
      --quick) amount=$quick; shift ;;
      --bin) bin=$2; shift 2 ;;
      *) usage ;;
    esac
  done
  scratch=$(mktemp -d)
  trap "rm -rf '$scratch'" EXIT
  for servers in 1 3; do
    timeout $((180 + amount * seconds_each)) "$bin/deltaray_torture" "$command" --servers "$servers" "--$unit" "$amount" \
      --seed "$seed" --directory "$scratch/$servers" >"$scratch/log.$servers" 2>&1 || code=1
    grep -v "^$command:" "$scratch/log.$servers" || true
  done
  cat "$scratch"/log.* | grep "^$command:" | paste -sd '|' | sed 's/|/; /g'
  exit "$code"
}
