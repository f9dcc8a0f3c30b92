#!/usr/bin/env bash
# usage: history.sh [--seconds N] [--seed N] [--quick] [--bin BIN]
# Clients upload, rename, delete and trace the same few meshes, through one server and through three that share a
# directory, while servers are killed and started again, or stopped for a time, and connections are cut. Each answer must
# be that of brute force on a mesh that was live, or that the name led to, during the call; no batch of a stream may be
# lost, doubled or out of order.
source "$(dirname "${BASH_SOURCE[0]}")/fleets.sh"
amount=300 unit=seconds quick=12 seconds_each=1
torture_fleets history "$@"
