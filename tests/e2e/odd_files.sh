#!/usr/bin/env bash
# usage: odd_files.sh BIN
# Uploads each OBJ, PLY and STL file of Debian's assimp-testmodels: each becomes a mesh that answers rays, or is refused
# with a reason and leaves nothing behind, and the server lives on.
source "$(dirname "${BASH_SOURCE[0]}")/server.sh"
models=/usr/share/assimp/models
need_file "$models" assimp-testmodels
invalid_argument=67

start_server
good=0
refused=0
while IFS= read -r -d '' file; do
  code=0
  client upload "$file" >"$scratch/out" 2>"$scratch/err" || code=$?
  case $code in
    0)
      good=$((good + 1))
      id=$(cat "$scratch/out")
      expect 0 client cast "$id" --kind count --format csv - <<<"0,0,1000,0.001,0.002,-1"
      [ "$(wc -l <"$scratch/out")" -eq 2 ] || fail "$file: no answer to one ray"
      expect 0 client delete "$id"
      ;;
    "$invalid_argument")
      refused=$((refused + 1))
      [ -s "$scratch/err" ] || fail "$file was refused without a word"
      echo "refused: ${file#"$models"/}: $(cat "$scratch/err")"
      ;;
    *) cat "$scratch/err"; fail "$file: exit code $code" ;;
  esac
done < <(find "$models" -type f \( -iname '*.obj' -o -iname '*.ply' -o -iname '*.stl' \) -print0 | sort -z)
echo "$good files became meshes, $refused were refused"

# Files that are in order must be taken, and files that are not must be refused.
for file in OBJ/box.obj OBJ/concave_polygon.obj OBJ/spider.obj PLY/cube.ply PLY/cube_binary.ply PLY/cube_uv.ply \
  STL/Spider_ascii.stl STL/Spider_binary.stl STL/sphereWithHole.stl; do
  expect 0 client upload "$models/$file"
  expect 0 client delete "$(cat "$scratch/out")"
done
for file in OBJ/box_UTF16BE.obj invalid/malformed.obj; do
  expect "$invalid_argument" client upload "$models/$file"
done
expect 0 client list --format csv
[ "$(wc -l <"$scratch/out")" -eq 1 ] || fail "meshes are left: $(cat "$scratch/out")"
stop_server
[ -z "$(find "$data" -type f -size +0)" ] || fail "files are left: $(find "$data" -type f)"
