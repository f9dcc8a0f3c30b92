#!/usr/bin/env bash
# usage: balancer_config.sh ROOT
# Has nginx check docker/balancer/nginx.conf, with addresses in place of the names that only a compose file or a cluster
# knows.
set -euo pipefail
command -v nginx >/dev/null || { echo "SKIPPED: nginx is missing; it comes with the package nginx-light"; exit 77; }

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
sed -E -e 's/server server[1-3]:/server 127.0.0.1:/' -e "s|/tmp/|$scratch/|" "$1/docker/balancer/nginx.conf" >"$scratch/nginx.conf"
nginx -t -e stderr -c "$scratch/nginx.conf"
