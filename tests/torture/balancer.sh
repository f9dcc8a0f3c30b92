#!/usr/bin/env bash
# usage: balancer.sh [--rounds N] [--rays N] [--max-wait-ms N] [--quick] [--bin BIN]
# nginx, by docker/balancer/nginx.conf, before three servers on one data directory, rays at full load: how fast against the
# servers without it; then, N times (5; quick: 1), one server is killed with SIGKILL and started again. No answer may be
# wrong or missing, and no client may fail; they see a pause. Tells how many trees had to be built again for it. A stream
# has 4 and then 20 times so many rays (200,000; quick: 50,000). Its next hits, the first ones too, may take --max-wait-ms
# (5000) and five times the longest wait without losses.
here=$(dirname "${BASH_SOURCE[0]}")
command -v nginx >/dev/null || { echo "SKIPPED: nginx is missing; it comes with the package nginx-light"; exit 77; }
rounds=5 seconds=10 meshes=12 rays=200000 max_wait_ms=5000
bin=$here/../../build/bin
while [ $# -gt 0 ]; do
  case "$1" in
    --quick) rounds=1 seconds=2 rays=50000; shift ;;
    --rounds) rounds=$2; shift 2 ;;
    --rays) rays=$2; shift 2 ;;
    --max-wait-ms) max_wait_ms=$2; shift 2 ;;
    --bin) bin=$2; shift 2 ;;
    *) echo "usage: balancer.sh [--rounds N] [--rays N] [--max-wait-ms N] [--quick] [--bin BIN]" >&2; exit 2 ;;
  esac
done
set -- "$bin"
source "$here/../e2e/server.sh"
passes=4 # of the rays in one stream

started=() # processes to end
nginx=
end_started() {
  local process
  for process in "${started[@]}"; do kill -KILL "$process" 2>/dev/null || true; done
  [ -z "$nginx" ] || { kill -TERM "$nginx" && wait "$nginx" || true; } # it ends its workers
}
trap 'code=$?; end_started; (exit $code); finish' EXIT

# One server for each number: its process, and the port that it has each time.
pids=() ports=()
at_port() { # as the launcher of start_server
  exec "$1" --listen "127.0.0.1:${ports[$number]:-0}" "${@:4}"
}
launcher=(at_port)
start_number() {
  number=$1
  start_server
  pids[number]=$server
  ports[number]=${address##*:}
  started+=("$server")
  server=
}

# --- Meshes, rays, and what the answers are
perl -e '
  my ($n, $dir) = @ARGV;
  for my $mesh (1 .. $n) {
    open(my $f, ">", "$dir/$mesh.obj") or die;
    for my $y (0 .. 99) {
      for my $x (0 .. 99) { printf $f "v %d %d %.4f\n", $x, $y, 5 * sin($mesh * $x / 9) * cos($y / (3 + $mesh)) }
    }
    for my $y (0 .. 98) {
      for my $x (1 .. 99) { my $i = 100 * $y + $x; printf $f "f %d %d %d %d\n", $i, $i + 1, $i + 101, $i + 100 }
    }
  }' "$meshes" "$scratch"
perl -e '
  srand(7);
  binmode STDOUT;
  print pack("f<6", rand(99), rand(99), 50, rand(0.6) - 0.3, rand(0.6) - 0.3, -1) for 1 .. $ARGV[0]' "$rays" >"$scratch/rays.f32"
# again FILE TIMES: prints it so many times.
again() { local i; for i in $(seq "$2"); do cat "$1"; done; }
# cast ADDRESS MESH PASSES: prints the hits.
cast() {
  again "$scratch/rays.f32" "$3" | timeout 120 "$bin/deltaray" --server "$1" cast "mesh-$2" - --rays-format f32x6 \
    --batch 4096 --columns t,primitive_id --format raw "${@:4}"
}

# Servers are started after the upload, so that no tree is there but those that queries ask for.
start_number 0
for mesh in $(seq "$meshes"); do
  expect 0 client upload "$scratch/$mesh.obj" --name "mesh-$mesh"
  cast "$address" "$mesh" 1 >"$scratch/$mesh.want" || fail "no answer of mesh $mesh"
done
[ "$(cat "$scratch"/*.want | wc -c)" -eq $((meshes * rays * 8)) ] || fail "not a hit of 8 bytes for each ray"
server=${pids[0]}
stop_server
for number in 0 1 2; do start_number "$number"; done

# --- nginx, at a port that a server has found free
start_number 3
server=${pids[3]}
crash_server
balancer="127.0.0.1:${ports[3]}"
sed -E -e "s/server server1:7878/server 127.0.0.1:${ports[0]}/" -e "s/server server2:7878/server 127.0.0.1:${ports[1]}/" \
  -e "s/server server3:7878/server 127.0.0.1:${ports[2]}/" -e "s/listen 7878/listen $balancer/" \
  -e "s|/tmp/|$scratch/|" -e "s|error_log stderr|error_log $scratch/nginx.log|" "$here/../../docker/balancer/nginx.conf" >"$scratch/nginx.conf"
nginx -e "$scratch/nginx.log" -c "$scratch/nginx.conf" -g 'daemon off;' >"$scratch/nginx.out" 2>&1 &
nginx=$!
for i in $(seq 100); do
  ! timeout 10 "$bin/deltaray" --server "$balancer" list >/dev/null 2>&1 || break
  [ "$i" -lt 100 ] || fail "nginx does not pass calls on: $(cat "$scratch/nginx.log")"
  sleep 0.1
done

# check MESH: compares standard input with the hits that are right, and prints the longest wait for some of them, in ms.
# While they come there is $scratch/MESH.busy.
check() {
  perl -e '
    use Time::HiRes "time";
    my ($file, $passes, $busy) = @ARGV;
    open(my $f, "<:raw", $file) or die;
    my $want = do { local $/; <$f> } x $passes;
    binmode STDIN;
    my ($at, $longest, $last) = (0, 0, time);
    while (my $count = sysread(STDIN, my $hits, 1 << 16)) {
      if ($at == 0) { open(my $b, ">", $busy) or die }
      my $wait = time - $last;
      $last += $wait;
      $longest = $wait if $wait > $longest;
      exit 1 if substr($want, $at, $count) ne $hits;
      $at += $count;
    }
    unlink $busy;
    exit 1 if $at != length $want;
    printf "%d\n", 1000 * $longest' "$scratch/$1.want" "$passes" "$scratch/$1.busy"
}
# work MESH WHERE: streams rays at the mesh until $scratch/stop is there; the longest wait of each stream goes to
# $scratch/MESH.waits. WHERE: a function that prints the address to ask for a mesh.
work() {
  while [ ! -e "$scratch/stop" ]; do
    cast "$("$2" "$1")" "$1" "$passes" | check "$1" >>"$scratch/$1.waits" || { echo "mesh $1" >>"$scratch/wrong"; return; }
  done
}
direct() { echo "127.0.0.1:${ports[$(($1 % 3))]}"; }
through() { echo "$balancer"; }

# start_work WHERE: one worker a mesh, so that each server has work at any time.
start_work() {
  local mesh
  rm -f "$scratch"/*.waits "$scratch/stop"
  began=$(date +%s%N)
  working=()
  for mesh in $(seq "$meshes"); do
    work "$mesh" "$1" 2>>"$scratch/client.log" &
    working+=($!)
    started+=($!)
  done
}
# end_work: sets $casts, $wait_ms, and $mrays, a second.
end_work() {
  touch "$scratch/stop"
  wait "${working[@]}"
  [ ! -e "$scratch/wrong" ] || { cat "$scratch/client.log" "$scratch/nginx.log"; fail "wrong or missing answers: $(cat "$scratch/wrong")"; }
  casts=$(cat "$scratch"/*.waits | wc -l)
  wait_ms=$(cat "$scratch"/*.waits | sort -n | tail -1)
  mrays=$(awk -v n="$casts" -v rays=$((rays * passes)) -v ns=$(($(date +%s%N) - began)) 'BEGIN { printf "%.2f", 1000 * n * rays / ns }')
}
# trees NUMBER: those that the server holds.
trees() { "$bin/deltaray" --server "127.0.0.1:${ports[$1]}" --timeout 60 list --format json | grep -c '"state": *"MESH_STATE_READY"' || true; }

# --- How fast, without and with nginx. Trees are built before the clock runs.
for mesh in $(seq "$meshes"); do cast "$balancer" "$mesh" 1 --wait-final >/dev/null || fail "no answer through nginx"; done
held=()
for number in 0 1 2; do held[number]=$(trees "$number"); done
echo "trees: ${held[*]} of $meshes meshes on three servers"
[ $((held[0] + held[1] + held[2])) -eq "$meshes" ] || fail "calls about one mesh went to several servers: ${held[*]} trees"
start_work through
sleep "$seconds"
end_work
nginx_mrays=$mrays calm_wait_ms=$wait_ms
for mesh in $(seq "$meshes"); do cast "$(direct "$mesh")" "$mesh" 1 --wait-final >/dev/null || fail "no answer"; done
start_work direct
sleep "$seconds"
end_work
direct_mrays=$mrays

# --- Losses
for number in 0 1 2; do # forget the trees of the direct calls
  server=${pids[number]}
  stop_server
  start_number "$number"
done
sleep 6 # nginx tries them again
for mesh in $(seq "$meshes"); do cast "$balancer" "$mesh" 1 --wait-final >/dev/null || fail "no answer through nginx"; done
rebuilt=0 lost_trees=0
passes=20 # streams last, so that some are under way at each loss
start_work through
# By nginx' own log, in which a refused connection is a call that had not begun.
resumed() { grep -cE 'prematurely closed|\((32|104): ' "$scratch/nginx.log" || true; }
# Goes on for some rounds more while no call was under way at a loss, as where streams are short.
for ((round = 0; round < rounds || (round < rounds + 5 && $(resumed) == 0); ++round)); do
  killed=$((round % 3))
  before=()
  for number in 0 1 2; do before[number]=$(trees "$number"); done
  for i in $(seq 600); do
    [ "$(find "$scratch" -name '*.busy' | wc -l)" -lt $((meshes * 3 / 4)) ] || break
    sleep 0.1
  done
  server=${pids[killed]}
  crash_server
  sleep "$((seconds < 5 ? seconds : 5))"
  start_number "$killed"
  sleep 7 # nginx gives it its meshes back
  lost_trees=$((lost_trees + before[killed]))
  before[killed]=0
  for number in 0 1 2; do rebuilt=$((rebuilt + $(trees "$number") - before[number])); done
done
end_work
resumed=$(resumed)
[ "$resumed" -gt 0 ] || { cat "$scratch/nginx.log"; fail "no call was under way when servers were killed"; }
[ "$wait_ms" -le $((max_wait_ms + 5 * calm_wait_ms)) ] || fail "a client waited for $wait_ms ms, $calm_wait_ms ms without losses"
# Each lost tree is built where its calls go meanwhile, and once more where it was.
[ "$rebuilt" -le $((2 * lost_trees)) ] || fail "$rebuilt trees were built again for $lost_trees that were lost"
for number in 0 1 2; do
  server=${pids[number]}
  stop_server
done

echo "balancer: a server killed and restarted $round times under $casts streams of $((rays * passes)) rays, 0 wrong, 0 lost, $resumed resumed;" \
  "longest wait for hits $wait_ms ms, $calm_wait_ms ms without losses; $rebuilt trees built again for $lost_trees lost of $((round * meshes));" \
  "through nginx $nginx_mrays Mrays/s, direct $direct_mrays, ratio $(awk -v a="$nginx_mrays" -v b="$direct_mrays" 'BEGIN { printf "%.2f", a / b }')"
