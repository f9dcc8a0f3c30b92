#!/usr/bin/env bash
# usage: monitoring.sh BIN
# Every metric that the dashboard and the alert rules ask for is one that the server exports, and every one that it
# exports is in server/README.md, which names no other. Where promtool, jq are installed, they read the files too.
# shellcheck source=tests/e2e/server.sh
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
monitoring="$root/docker/monitoring"

export DELTARAY_METRICS_LISTEN=127.0.0.1:0
start_server
# The log tells it a moment after the port's file is there.
for _ in $(seq 100); do
  port=$(sed -n 's/.* metrics_port=\([0-9]*\).*/\1/p' "$scratch/server.log")
  [ -z "$port" ] || break
  sleep 0.1
done
[ "${port:-0}" -gt 0 ] || fail "the log tells no port of the metrics"

# Something of everything, since a histogram is there once it holds something.
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' >"$scratch/triangle.obj"
expect 0 client upload "$scratch/triangle.obj" --name triangle --wait
echo 0.2,0.2,1,0,0,-1 >"$scratch/rays.csv"
expect 0 client cast triangle "$scratch/rays.csv"
expect 0 client health triangle
expect_text "$scratch/out" '^SERVING$'
expect 69 client health nothing
expect_text "$scratch/err" 'request [0-9a-f]+-[0-9]+'

exec 3<>"/dev/tcp/127.0.0.1/$port"
printf 'GET /metrics HTTP/1.0\r\n\r\n' >&3
tr -d '\r' <&3 >"$scratch/page"
exec 3>&-
expect_text "$scratch/page" '^deltaray_rays_total\{kind="closest_hit",level="exact"\} 1$'

# What may be asked for: a family by its name, a histogram by its three parts.
awk '/^# TYPE / && $4 == "histogram" { print $3 "_bucket"; print $3 "_count"; print $3 "_sum" }
     /^# TYPE / && $4 != "histogram" { print $3 }' "$scratch/page" | sort -u >"$scratch/asked"
awk '/^# TYPE deltaray_/ { print $3 }' "$scratch/page" | sort -u >"$scratch/families"

# known NAMES KNOWN TEXT: fails where a line of NAMES is not in KNOWN.
known() {
  local missing
  missing=$(comm -23 "$1" "$2")
  [ -z "$missing" ] || fail "$3: $missing"
}
metrics='\b(deltaray|process)_[a-z_]+'
for file in alerts.yml grafana/dashboard.json; do
  grep -oE "$metrics" "$monitoring/$file" | sort -u >"$scratch/names"
  [ "$(wc -l <"$scratch/names")" -ge 5 ] || fail "$file asks for next to nothing"
  known "$scratch/names" "$scratch/asked" "docker/monitoring/$file asks for what the server does not export"
done
grep -oE '`deltaray_[a-z_]+`' "$root/server/README.md" | tr -d '`' | sort -u >"$scratch/names"
known "$scratch/names" "$scratch/families" "server/README.md tells of what the server does not export"
known "$scratch/families" "$scratch/names" "server/README.md lacks"

if command -v promtool >/dev/null; then
  promtool check rules "$monitoring/alerts.yml"
  promtool check config --syntax-only "$monitoring/prometheus.yml"
  sed "1,/^$/d" "$scratch/page" | promtool check metrics || true # of prometheus-cpp's own names it thinks little
fi
if command -v jq >/dev/null; then jq -e '.panels | length > 10' "$monitoring/grafana/dashboard.json" >/dev/null; fi

stop_server
echo "$(wc -l <"$scratch/families") families of metrics, all of them documented"
