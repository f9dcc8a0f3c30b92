#!/usr/bin/env bash
# usage: install_packages.sh GROUP...
# Installs those packages of the groups (see packages.txt) that are missing, and says which. Needs Debian 12 or a system
# with packages of the same names; uses sudo where not root. Does nothing, and needs no network, where none is missing.
set -euo pipefail

list="$(dirname "${BASH_SOURCE[0]}")/packages.txt"
fail() { echo "install_packages.sh: $*" >&2; exit 1; }
[ $# -gt 0 ] || fail "name at least one group of $list"

wanted=()
for group in "$@"; do
  mapfile -t found < <(awk -v group="$group" '!/^#/ && ("," $2 ",") ~ ("," group ",") { print $1 }' "$list")
  [ ${#found[@]} -gt 0 ] || fail "$list has no group '$group'"
  wanted+=("${found[@]}")
done

if ! command -v dpkg-query >/dev/null || ! command -v apt-get >/dev/null; then
  echo "This is no Debian system. deltaray needs these packages of Debian 12, or what they are called here:" >&2
  printf '  %s\n' "${wanted[@]}" >&2
  fail "cannot install them without apt"
fi

missing=()
for package in "${wanted[@]}"; do
  status=$(dpkg-query --show --showformat='${db:Status-Status}' "$package" 2>/dev/null || true)
  [ "$status" = installed ] || missing+=("$package")
done
[ ${#missing[@]} -gt 0 ] || exit 0

as_root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || fail "not root, and no sudo; as root, run: apt-get install ${missing[*]}"
  as_root=(sudo)
fi

echo "Installing ${#missing[@]} packages: ${missing[*]}"
"${as_root[@]}" apt-get update -q ||
  fail "apt-get update failed; are the network and the entries under /etc/apt in order?"
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${missing[@]}" ||
  fail "could not install ${missing[*]}; deltaray is made for the packages of Debian 12"
