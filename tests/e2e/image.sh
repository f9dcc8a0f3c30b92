#!/usr/bin/env bash
# usage: image.sh [--keep DIRECTORY]
# Does what docker/Dockerfile says, line by line, in fresh systems of Debian 12 made by debootstrap, then runs its entry
# point as its user in a root that is read-only, with no capabilities and a network of its own, and goes through the
# quick start there: upload, watch, render, statistics, health, SIGTERM. For machines without Docker; by hand, since it
# takes half an hour, 2 GB and the network. Needs root, debootstrap, iproute2 and the bunny (glmark2-data).
# With --keep a second run goes on from the stages that stand in the directory.
set -euo pipefail

if [ "${DELTARAY_IMAGE_NAMESPACE:-}" != 1 ]; then
  [ "$(id -u)" -eq 0 ] || { echo "image.sh: needs root, for chroot and mount" >&2; exit 1; }
  # All mounts below end with this process.
  DELTARAY_IMAGE_NAMESPACE=1 exec unshare --mount --propagation private bash "$0" "$@"
fi

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
# That of this system.
mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 'Codename: bookworm' | head -n 1)
mirror=${mirror%/}
bunny=/usr/share/glmark2/models/bunny.obj
fail() { echo "FAILED: $*" >&2; exit 1; }
for program in debootstrap ip chroot; do command -v "$program" >/dev/null || fail "$program is not installed"; done
[ -n "$mirror" ] || fail "apt has no lists of Debian 12; run apt-get update once"
[ -e "$bunny" ] || fail "$bunny is missing; it comes with the package glmark2-data"

if [ "${1:-}" = --keep ]; then
  work=$(realpath -m "$2")
  mkdir -p "$work"
  finish() { :; }
else
  work=$(mktemp -d)
  finish() { rm -rf --one-file-system "$work"; }
fi
unmount() { [ -z "$stage" ] || umount -R -l "$stage/proc" "$stage/dev" "$stage" 2>/dev/null || true; }
stage=
trap 'unmount; finish' EXIT

# The Dockerfile's instructions, one a line: continued lines joined, comments and empty lines dropped.
instructions() {
  sed -e ':a' -e '/\\$/{N;s/\\\n */ /;ba' -e '}' "$root/docker/Dockerfile" | grep -vE '^ *(#|$)'
}
# The words of a JSON array of strings, one a line.
words() { grep -oE '"[^"]*"' <<<"$1" | tr -d '"'; }

# fresh DIRECTORY: a minimal system with what its packages need to be installed, and the kernel's file systems.
fresh() {
  [ -e "$work/base/done" ] || {
    rm -rf "$work/base"
    debootstrap --variant=minbase bookworm "$work/base" "$mirror" >"$work/debootstrap.log" || fail "see $work/debootstrap.log"
    printf 'deb %s bookworm main\ndeb %s bookworm-updates main\ndeb %s-security bookworm-security main\n' \
      "$mirror" "$mirror" "$mirror" >"$work/base/etc/apt/sources.list"
    rm -rf "$work"/base/var/cache/apt/archives/*.deb "$work"/base/var/lib/apt/lists/*
    touch "$work/base/done"
  }
  cp -a "$work/base" "$1"
  rm "$1/done"
}
mount_kernel() {
  mount --bind /proc "$1/proc"
  mount --rbind /dev "$1/dev"
}
in_stage() { chroot "$stage" /usr/bin/env -i PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/ $environment "$@"; }

# copy ARGUMENTS of COPY: from another stage, or from the files of this repository that git does not ignore.
copy() {
  local from="$root" sources target
  if [[ "$1" == --from=* ]]; then from="$work/stage-${1#--from=}"; shift; fi
  target="${!#}"
  [[ "$target" == /* ]] || target="$workdir/$target"
  sources=("${@:1:$#-1}")
  mkdir -p "$stage$target"
  if [ "$from" != "$root" ]; then
    for source in "${sources[@]}"; do cp -a "$from$source" "$stage$target"; done
  elif [ "${sources[*]}" = . ]; then
    git -C "$root" ls-files -z --cached --others --exclude-standard |
      tar -C "$root" --null --files-from=- --ignore-failed-read -cf - 2>/dev/null | tar -C "$stage$target" -xf -
  else
    for source in "${sources[@]}"; do cp -a "$root/$source" "$stage$target"; done
  fi
}

environment= workdir=/ user=root health=() entry=() volume= done_before=
while IFS= read -r instruction; do
  name=${instruction%% *} arguments=${instruction#* }
  if [ "$name" = FROM ]; then
    [ -z "$stage" ] || [ -n "$done_before" ] || { umount -R "$stage/proc" "$stage/dev"; touch "$stage.done"; }
    read -r image as stage_name <<<"$arguments"
    [[ "$image" == debian:bookworm* ]] || fail "the Dockerfile begins with $image; this script makes Debian 12"
    stage="$work/stage-${stage_name:-final}" environment= workdir=/ user=root
    done_before=
    if [ "${as:-}" = AS ] && [ -e "$stage.done" ]; then
      done_before=yes
    else
      rm -rf --one-file-system "$stage"
      fresh "$stage"
      mount_kernel "$stage"
      cp -L /etc/resolv.conf "$stage/etc/resolv.conf"
    fi
  fi
  [ -z "$done_before" ] || continue
  echo "== $instruction"
  case "$name" in
    FROM) ;;
    WORKDIR) workdir=$arguments; mkdir -p "$stage$workdir" ;;
    COPY) eval "copy $arguments" ;;
    RUN) in_stage /bin/sh -c "cd $workdir && $arguments" >"$work/run.log" 2>&1 </dev/null || { tail -n 40 "$work/run.log"; fail "$instruction"; } ;;
    USER) user=$arguments ;;
    ENV) environment+=" $arguments" ;;  # NAME=VALUE without spaces
    VOLUME) volume=$arguments ;;
    EXPOSE) ;;
    HEALTHCHECK) mapfile -t health < <(words "${arguments#*CMD}") ;;
    ENTRYPOINT) mapfile -t entry < <(words "$arguments") ;;
    *) fail "this script does not know $name" ;;
  esac
done < <(instructions)
[ "$user" != root ] || fail "the image runs as root"
umount -R "$stage/proc" "$stage/dev"
base_mb=$(du -sm "$work/base" | cut -f1)
image_mb=$(du -sm "$stage" | cut -f1)

# As the engine would run it: read-only, a volume and nothing else to write to.
mkdir -p "$work/volume" "$work/pictures"
chown 10001 "$work/volume" "$work/pictures"
cp "$bunny" "$work/pictures/"
mount --bind "$stage" "$stage"
mount --bind "$work/volume" "$stage$volume"
mkdir -p "$stage/mnt"
mount --bind "$work/pictures" "$stage/mnt"
mount_kernel "$stage"
mount -o remount,bind,ro "$stage"
if touch "$stage/etc/written" 2>/dev/null; then fail "the root is not read-only"; fi
group=$(in_stage id -g "$user")
as_user() {
  in_stage setpriv --reuid="$user" --regid="$group" --clear-groups --no-new-privs --bounding-set=-all "$@"
}

export -f as_user in_stage
export stage user group environment
# One network namespace for server and clients.
unshare --net bash -c '
  set -euo pipefail
  work=$1 health=$2; shift 2
  fail() { echo "FAILED: $*" >&2; tail -n 20 "$work/server.log" >&2; exit 1; }
  ip link set lo up
  as_user "$@" 2>"$work/server.log" &
  server=$!
  trap "kill -KILL $server 2>/dev/null || true" EXIT
  for i in $(seq 100); do as_user $health >/dev/null 2>&1 && break; sleep 0.1; done
  as_user $health || fail "the health check does not pass within 10 s"
  client() { as_user timeout 120 deltaray "$@"; }
  client upload --name bunny /mnt/bunny.obj
  client watch bunny
  client render bunny --size 640x480 --wait-final --output /mnt/bunny.png
  client stats bunny >/dev/null
  client health bunny
  exec 3<>/dev/tcp/127.0.0.1/9464
  printf "GET /metrics HTTP/1.0\r\n\r\n" >&3
  grep -q "^deltaray_rays_total{kind=\"closest_hit\",level=\"exact\"} 307200" <&3 || fail "the metrics do not count the picture"
  [ "$(stat -c %u "$work/pictures/bunny.png")" -eq 10001 ] || fail "the picture is not the user'"'"'s"
  pid=$(pgrep -x deltarayd --parent $server || echo $server)
  grep -qE "^Uid:\s10001\s10001\s10001" /proc/$pid/status || fail "the server does not run as the user of the image"
  kill -TERM $pid
  code=0; wait $server || code=$?
  trap - EXIT
  [ $code -eq 0 ] || fail "the server ended with exit code $code after SIGTERM"
' bash "$work" "${health[*]}" "${entry[@]}"

echo "the image takes $image_mb MB, $base_mb MB of them Debian; it ran as $user with a read-only root"
