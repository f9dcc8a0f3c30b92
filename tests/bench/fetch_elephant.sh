#!/usr/bin/env bash
# Fetches CGAL's elephant (5,558 triangles) and armadillo (52,000) for benchmarks: from Debian's package libcgal-demo,
# which is neither installed nor kept, to scenes/elephant.obj and scenes/armadillo.obj in the build directory.
#
# usage: tests/bench/fetch_elephant.sh [BUILD_DIRECTORY]   (default: build)
set -euo pipefail
cd "$(dirname "$0")/../.."
scenes="${1:-build}/scenes"
package=libcgal-demo

if [ -s "$scenes/elephant.obj" ] && [ -s "$scenes/armadillo.obj" ]; then
  echo "$scenes/elephant.obj and armadillo.obj are there already."
  exit 0
fi
if ! command -v apt-get > /dev/null; then
  echo "fetch_elephant.sh: apt-get is missing; this needs Debian or a system that has its packages." >&2
  exit 1
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
echo "Fetching $package from Debian ..."
# apt fetches as a user without rights, who must be able to write here.
chmod 777 "$work"
(cd "$work" && apt-get download -q "$package")
dpkg-deb --fsys-tarfile "$work/$package"_*.deb |
  tar -xO ./usr/share/doc/libcgal-dev/data.tar.gz |
  tar -xz -C "$work" data/meshes/elephant.off data/meshes/armadillo.off
mkdir -p "$scenes"
for name in elephant armadillo; do
  # OFF: "OFF", the number of vertices, faces and edges, the vertices, the faces as "3 a b c" counted from zero.
  awk 'NF == 0 || /^OFF/ { next }
       !vertices { vertices = $1; next }
       read < vertices { print "v", $1, $2, $3; read++; next }
       { print "f", $2 + 1, $3 + 1, $4 + 1 }' "$work/data/meshes/$name.off" > "$scenes/$name.obj.part"
  # Whole or not at all.
  mv "$scenes/$name.obj.part" "$scenes/$name.obj"
  echo "Wrote $scenes/$name.obj."
done
