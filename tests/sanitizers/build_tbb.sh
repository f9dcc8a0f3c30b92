#!/usr/bin/env bash
# usage: build_tbb.sh DIRECTORY
# Builds TBB for ThreadSanitizer in DIRECTORY and installs it to DIRECTORY/install; does nothing where that is done.
#
# ThreadSanitizer must see the synchronisation inside of TBB, or it takes what the tasks of an uninstrumented TBB hand to
# each other for races. The source is Debian's own, of the version that is installed, from the mirrors that the system
# uses for its other packages. Needs dpkg-dev and cmake, not root.
set -euo pipefail

directory=$(mkdir -p "$1" && cd "$1" && pwd)
read -r source version < <(dpkg-query --show --showformat='${source:Package} ${source:Version}\n' libtbb-dev)
compiler=${CXX:-c++}
built="$directory/built"
wanted="$source $version $compiler"
if [ "$(cat "$built" 2>/dev/null)" = "$wanted" ]; then
  exit 0
fi
echo "Building $source $version for ThreadSanitizer (once per build directory)"
rm -rf "${directory:?}"/*
cd "$directory"

# Ask the system's own mirrors for sources, without touching the system's lists.
mkdir -p apt/lists/partial apt/parts apt/cache/archives/partial
for entry in /etc/apt/sources.list /etc/apt/sources.list.d/*; do
  case "$entry" in
    *.sources) sed -E 's/^Types:.*/Types: deb-src/' "$entry" >"apt/parts/${entry##*/}" ;;
    *.list) [ ! -e "$entry" ] || sed -nE 's/^deb(-src)? /deb-src /p' "$entry" >"apt/parts/${entry##*/}" ;;
  esac
done
apt=(apt-get -q -o Dir::Etc::sourcelist=/dev/null -o Dir::Etc::sourceparts="$PWD/apt/parts"
  -o Dir::State::lists="$PWD/apt/lists" -o Dir::Cache="$PWD/apt/cache" -o APT::Sandbox::User="$(id -un)")
"${apt[@]}" update
"${apt[@]}" source "$source=$version"
rm -rf apt

source_directory=$(find . -maxdepth 1 -type d -name "$source-*")
cmake -S "$source_directory" -B build -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_INSTALL_PREFIX="$directory/install" \
  -DCMAKE_CXX_COMPILER="$compiler" -DTBB_SANITIZE=thread -DTBB_TEST=OFF -DTBB_STRICT=OFF -DTBBMALLOC_BUILD=OFF
cmake --build build --parallel "$(nproc)"
cmake --install build
rm -rf build "$source_directory"
echo "$wanted" >"$built"
