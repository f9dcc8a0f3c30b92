#!/usr/bin/env bash
# usage: crash.sh [--rounds N] [--seed N] [--quick] [--bin BIN]
# kill -9 at N random moments of uploads, renames, deletes, builds and queries: on one server, and on three that share a
# directory. Nothing that was acknowledged may be lost, and no file may be left that belongs to nothing.
source "$(dirname "${BASH_SOURCE[0]}")/fleets.sh"
amount=300 unit=rounds quick=12 seconds_each=60
torture_fleets crash "$@"
