#!/usr/bin/env bash
# usage: main_job.sh BIN
# The main job through the two programs: upload, watch, cast, statistics, picture, delete, drain; first on a mesh whose
# answers are known, then on a real one.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"
bunny=/usr/share/glmark2/models/bunny.obj
need_file "$bunny" glmark2-data

# same_lines FILE: compares standard input with the file.
same_lines() {
  diff - "$1" || fail "$1 is not what was expected (<)"
}

start_server

# A square of two triangles at z = 0, seen from its front above, and a triangle at z = -1.
cat >"$scratch/square.obj" <<'EOT'
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 -1
v 1 0 -1
v 1 1 -1
f 1 2 3 4
f 5 6 7
EOT
# From above; from above with a direction of length 2; from below; past it.
cat >"$scratch/rays.csv" <<'EOT'
0.75,0.25,1,0,0,-1
0.25,0.75,1,0,0,-2
0.75,0.25,-3,0,0,1
2,2,1,0,0,-1
EOT
expect 0 client upload --name square - <"$scratch/square.obj"
id=$(cat "$scratch/out")
expect_text "$scratch/out" '^[0-9a-f]{64}$'
expect 0 client watch square
expect_text "$scratch/out" 'ready'

expect 0 client cast square "$scratch/rays.csv" --columns t,face_id,flags --format csv
same_lines "$scratch/out" <<'EOT'
ray,t,face_id,hit,back
0,1,0,1,0
1,0.5,0,1,0
2,2,1,1,1
3,inf,4294967295,0,0
EOT
expect 0 client cast square - --kind any --format csv <"$scratch/rays.csv"
same_lines "$scratch/out" <<'EOT'
ray,hit
0,1
1,1
2,1
3,0
EOT
expect 0 client cast square "$scratch/rays.csv" --kind count --batch 1 --format csv
same_lines "$scratch/out" <<'EOT'
ray,count
0,2
1,1
2,2
3,0
EOT
expect 0 client cast square "$scratch/rays.csv" --kind all --columns t --cull back --format csv
same_lines "$scratch/out" <<'EOT'
ray,t
0,1
0,2
1,0.5
EOT

# The same mesh twice is one mesh; its id does not depend on the format.
cat >"$scratch/square.ply" <<'EOT'
ply
format ascii 1.0
element vertex 7
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 0
0 0 -1
1 0 -1
1 1 -1
4 0 1 2 3
3 4 5 6
EOT
expect 0 client upload "$scratch/square.ply"
same_lines "$scratch/out" <<<"$id"

# A real mesh: rays from every side of its middle must hit it, and nothing is outside of its bounds.
expect 0 client upload --name bunny "$bunny"
expect 0 client render bunny --size 640x480 -o "$scratch/early.png"
expect 0 client watch bunny
expect 0 client stats bunny --format json
expect_text "$scratch/out" '"triangles": *"?69666'
expect 0 client render bunny --size 640x480 --wait-final -o "$scratch/bunny.png"
expect_text "$scratch/err" '^307,200 rays, [1-9][0-9,]+ hits'
# PNG: signature; then the header's width and height, big-endian.
[ "$(od -A n -t x1 -N 8 "$scratch/bunny.png" | tr -d ' ')" = 89504e470d0a1a0a ] || fail "no PNG"
[ "$(od -A n -t x1 -j 16 -N 8 "$scratch/bunny.png" | tr -d ' ')" = 00000280000001e0 ] || fail "not 640x480"
# While the tree was built the rays got the same answers.
cmp "$scratch/early.png" "$scratch/bunny.png" || fail "the picture depends on the state of the tree"

expect 0 client list --format csv
[ "$(tail -n +2 "$scratch/out" | wc -l)" -eq 2 ] || fail "not two meshes: $(cat "$scratch/out")"
expect 0 client delete square
expect 69 client show square
expect 69 client show "$id"
expect 69 client cast square "$scratch/rays.csv"
expect 0 client show bunny
stop_server

# What was acknowledged is there after a restart; what was deleted is not.
start_server
expect 69 client show square
expect 0 client render bunny --size 640x480 --wait-final -o "$scratch/again.png"
cmp "$scratch/bunny.png" "$scratch/again.png" || fail "the picture differs after a restart"
expect 0 client delete bunny
stop_server
