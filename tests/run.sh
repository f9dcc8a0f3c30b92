#!/usr/bin/env bash
# usage: run.sh [--sanitize address,undefined | --sanitize thread] [-- CTEST_ARGUMENT...]
# Installs what is missing, compiles everything in a build directory of its own (build-tests, with warnings as errors;
# build-address, build-thread), and runs all tests. Exit code 0 only if all pass. CC and CXX choose the compiler.
# Example: tests/run.sh --sanitize thread -- -R '^store/'
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
usage() { sed -n '2,5s/^# //p' "${BASH_SOURCE[0]}"; }

sanitize=
while [ $# -gt 0 ]; do
  case "$1" in
    --sanitize) sanitize=${2:-}; shift $(($# > 1 ? 2 : 1)); [ -n "$sanitize" ] || { usage >&2; exit 2; } ;;
    --sanitize=*) sanitize=${1#*=}; shift ;;
    --help | -h) usage; exit 0 ;;
    --) shift; break ;;
    *) echo "run.sh: unknown argument '$1'" >&2; usage >&2; exit 2 ;;
  esac
done

bash "$root/docker/install_packages.sh" build test lint

options=(-DCMAKE_BUILD_TYPE=Release -DDELTARAY_WERROR=ON)
run=()
case "$sanitize" in
  '')
    build="$root/build-tests"
    # gold links three times as fast, and comes with binutils as the default linker does.
    options+=(-DDELTARAY_UNITY=ON -DCMAKE_EXE_LINKER_FLAGS=-fuse-ld=gold)
    ;;
  address,undefined)
    build="$root/build-address"
    # gcc warns of what is well where it also adds the sanitizers' checks. And one of the runs shows that each file
    # compiles by itself.
    options=(-DCMAKE_BUILD_TYPE=RelWithDebInfo -DDELTARAY_WERROR=OFF -DDELTARAY_PRECOMPILE=OFF
      "-DDELTARAY_SANITIZE=$sanitize")
    export ASAN_OPTIONS="detect_stack_use_after_return=1${ASAN_OPTIONS:+:$ASAN_OPTIONS}"
    export LSAN_OPTIONS="suppressions=$root/tests/sanitizers/lsan.supp:print_suppressions=0${LSAN_OPTIONS:+:$LSAN_OPTIONS}"
    export UBSAN_OPTIONS="print_stacktrace=1${UBSAN_OPTIONS:+:$UBSAN_OPTIONS}"
    ;;
  thread)
    build="$root/build-thread"
    bash "$root/tests/sanitizers/build_libraries.sh" "$build/libraries"
    options=(-DCMAKE_BUILD_TYPE=RelWithDebInfo -DDELTARAY_WERROR=OFF "-DDELTARAY_SANITIZE=$sanitize"
      -DCMAKE_EXE_LINKER_FLAGS="-Wl,--disable-new-dtags,-rpath,$build/libraries/lib")
    export TSAN_OPTIONS="suppressions=$root/tests/sanitizers/tsan.supp second_deadlock_stack=1 ${TSAN_OPTIONS:-}"
    # ThreadSanitizer cannot map its shadow memory where the kernel spreads addresses too widely.
    if setarch -R true 2>/dev/null; then run=(setarch -R); fi
    ;;
  *) echo "run.sh: --sanitize takes 'address,undefined' or 'thread', not '$sanitize'" >&2; exit 2 ;;
esac

cmake -S "$root" -B "$build" "${options[@]}"
"${run[@]}" cmake --build "$build" --parallel "$(nproc)"
"${run[@]}" ctest --test-dir "$build" --output-on-failure --no-tests=error --parallel "$(nproc)" "$@"
