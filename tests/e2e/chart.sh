#!/usr/bin/env bash
# usage: chart.sh BIN
# The chart of speed against accuracy of a real mesh at a live server, and the preset that goes by the mesh.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"
bunny=/usr/share/glmark2/models/bunny.obj
need_file "$bunny" glmark2-data

start_server
expect 0 client upload --name bunny --preset auto "$bunny"

for kind in camera chords bounce shadow; do
  expect 0 client chart bunny -o "$scratch/$kind.svg" --csv "$scratch/$kind.csv" --generate "$kind" --count 20000 --rounds 2
  expect_text "$scratch/out" '^rays +20,000, of which [1-9][0-9,]* hit$'
  expect_text "$scratch/out" '^cheapest level with at most 0 wrong answers per million: ((fast|watertight) \(none wrong of 20,000 rays, which shows fewer than 150 per million with 95 % confidence\)|exact \(.*\))$'
  expect_text "$scratch/$kind.svg" '^<svg '
  ! grep -q '^warning' "$scratch/err" || fail "a warning of rays that hit"
  # EXACT is the truth.
  expect_text "$scratch/$kind.csv" '^20000,[1-9][0-9]*,exact,exact,0,0,0,0,0,0,[0-9.]+$'
done
# Rays of the user's own.
printf '0,0,5,0,0,-1\n0,100,0,0,1,0\n' >"$scratch/rays.csv"
expect 0 client chart bunny -o "$scratch/own.svg" --rays "$scratch/rays.csv" --kind any --max-wrong-per-million 1000000 --format json
expect_text "$scratch/out" '"ray_count": *"2"'
expect_text "$scratch/err" '^cheapest level with at most 1e\+06 wrong answers per million: '
# As many rays of 64 bytes as a message holds, all of length zero.
truncate -s $((1048560 * 64)) "$scratch/rays.f64"
expect 0 client --timeout 100 chart bunny -o "$scratch/large.svg" --rays "$scratch/rays.f64" --rays-format f64x8 --rounds 1
expect_text "$scratch/out" '^rays +1,048,560, of which 0 hit$'
expect_text "$scratch/err" '^warning: none of the rays hits the mesh'
expect 69 client chart nothing -o "$scratch/none.svg"
[ ! -e "$scratch/none.svg" ] || fail "a chart of a mesh that is not there"

expect 0 client stats bunny
expect_text "$scratch/out" '^build +1: hybrid, auto, delta 32'
expect_text "$scratch/out" '^chosen +no spatial splits: '
# The same answers as of another tree.
expect 0 client render bunny --wait-final -o "$scratch/auto.png"
expect 0 client rebuild bunny --preset balanced --wait
expect 0 client render bunny --wait-final -o "$scratch/balanced.png"
cmp "$scratch/auto.png" "$scratch/balanced.png" || fail "the picture depends on the preset"
stop_server
