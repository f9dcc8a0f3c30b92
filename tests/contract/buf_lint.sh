#!/usr/bin/env bash
# usage: buf_lint.sh PROTO_DIRECTORY CACHE_DIRECTORY
# Checks the contract by the rules in buf.yaml. buf comes from npm into the cache directory. Exit code 77 (skipped) where
# npm is missing or cannot fetch it.
set -euo pipefail

version=1.75.0
proto=$1
cache=$2
buf="$cache/node_modules/.bin/buf"

if [ "$("$buf" --version 2>/dev/null || true)" != "$version" ]; then
  if ! command -v npm >/dev/null; then
    echo "SKIPPED: npm is not installed, so the contract was not checked by buf"
    exit 77
  fi
  mkdir -p "$cache"
  if ! npm install --prefix "$cache" --ignore-scripts --no-save --no-audit --no-fund --fetch-retries 1 \
    --fetch-timeout 60000 "@bufbuild/buf@$version"; then
    echo "SKIPPED: npm could not fetch @bufbuild/buf $version, so the contract was not checked by buf"
    exit 77
  fi
fi
"$buf" lint "$proto"
echo "buf $version finds nothing to say against $proto"
