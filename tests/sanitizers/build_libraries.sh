#!/usr/bin/env bash
# usage: build_libraries.sh DIRECTORY
# Builds TBB, Abseil and gRPC with ThreadSanitizer, as shared libraries in DIRECTORY/lib. They take the place of the
# installed ones when a program is run with that directory in its RPATH. What is built already is kept.
#
# ThreadSanitizer must see the synchronisation inside of these, or it takes whatever one thread hands to another through
# them for a race. The sources are Debian's own, of the versions that are installed, from the mirrors that the system uses
# for its other packages; the system itself is not touched. Needs no root.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
directory=$(mkdir -p "$1/lib" && cd "$1" && pwd)
cd "$directory"
compiler=${CXX:-c++}
c_compiler=${CC:-cc}
# Stacks in these libraries show functions without lines; debugging information would cost more time than it is worth.
flags="-O1 -DNDEBUG -fsanitize=thread -fno-omit-frame-pointer -w"

# Asks the system's own mirrors for sources, with lists of its own.
apt=()
fetch_lists() {
  rm -rf apt
  mkdir -p apt/lists/partial apt/parts apt/cache/archives/partial
  local entry
  for entry in /etc/apt/sources.list /etc/apt/sources.list.d/*; do
    case "$entry" in
      *.sources) sed -E 's/^Types:.*/Types: deb-src/' "$entry" >"apt/parts/${entry##*/}" ;;
      *.list) [ ! -e "$entry" ] || sed -nE 's/^deb(-src)? /deb-src /p' "$entry" >"apt/parts/${entry##*/}" ;;
    esac
  done
  apt=(apt-get -q -o Dir::Etc::sourcelist=/dev/null -o Dir::Etc::sourceparts="$PWD/apt/parts"
    -o Dir::State::lists="$PWD/apt/lists" -o Dir::Cache="$PWD/apt/cache" -o APT::Sandbox::User="$(id -un)")
  "${apt[@]}" update
}

# build PACKAGE TARGET CMAKE_ARGUMENT...: builds the shared libraries of a target of the package's source.
build() {
  local package=$1 target=$2 source version
  shift 2
  read -r source version < <(dpkg-query --show --showformat='${source:Package} ${source:Version}\n' "$package")
  local stamp="$source.built" wanted="$version $compiler"
  [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ] || return 0
  echo "Building $source $version for ThreadSanitizer, once per build directory"
  [ ${#apt[@]} -gt 0 ] || fetch_lists
  rm -rf source && mkdir source
  (cd source && "${apt[@]}" source "$source=$version")
  # Without RPATHs of their own, so that the program's decides.
  cmake -S "$(find source -mindepth 1 -maxdepth 1 -type d)" -B "$source" \
    -DCMAKE_BUILD_TYPE=None -DCMAKE_CXX_STANDARD=17 -DBUILD_SHARED_LIBS=ON -DCMAKE_SKIP_RPATH=ON \
    -DCMAKE_C_COMPILER="$c_compiler" -DCMAKE_CXX_COMPILER="$compiler" -DCMAKE_C_FLAGS="$flags" -DCMAKE_CXX_FLAGS="$flags" "$@"
  cmake --build "$source" --parallel "$(nproc)" --target "$target"
  find "$source" -name '*.so.*' -exec cp -P -t lib {} +
  rm -rf source "$source"
  echo "$wanted" >"$stamp"
}

build libtbb-dev tbb -DTBB_TEST=OFF -DTBB_STRICT=OFF -DTBBMALLOC_BUILD=OFF
build libabsl-dev all -DBUILD_TESTING=OFF
build libgrpc++-dev grpc++ -DCMAKE_PROJECT_grpc_INCLUDE="$here/grpc_parts.cmake" \
  -DgRPC_INSTALL=OFF -DgRPC_BUILD_TESTS=OFF -DgRPC_BUILD_CODEGEN=OFF \
  -DgRPC_ABSL_PROVIDER=package -DgRPC_CARES_PROVIDER=package -DgRPC_PROTOBUF_PROVIDER=package \
  -DgRPC_RE2_PROVIDER=package -DgRPC_SSL_PROVIDER=package -DgRPC_ZLIB_PROVIDER=package \
  -DProtobuf_PROTOC_LIBRARY=unused
rm -rf apt
