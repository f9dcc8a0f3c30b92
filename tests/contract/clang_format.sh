#!/usr/bin/env bash
# usage: clang_format.sh ROOT
# Checks that all C++ source is formatted as .clang-format says. Exit code 77 (skipped) where clang-format is missing.
set -euo pipefail

cd "$1"
if ! command -v clang-format >/dev/null; then
  echo "SKIPPED: clang-format is not installed"
  exit 77
fi
mapfile -t sources < <(find server client tests -name '*.h' -o -name '*.cc' | sort)
[ ${#sources[@]} -gt 0 ] || { echo "no source found under $PWD"; exit 1; }
clang-format --dry-run --Werror "${sources[@]}"
echo "${#sources[@]} files are formatted"
