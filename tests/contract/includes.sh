#!/usr/bin/env bash
# usage: includes.sh ROOT
# Checks that each folder includes only what its layer may see: geometry <- { mesh, tree } <- build <- store <- service,
# that the client and the server know each other by the contract alone, and that a header of gRPC or of the contract
# is seen only in server/service, server/main.cc and client. A wrong include of a header without a .cc would still link.
set -euo pipefail

cd "$1"
failed=0

# check FOLDER REGEX: every #include "server/..." or "client/..." of the folder's files must match the regex.
check() {
  local files wrong
  files=$(find "$1" -name '*.h' -o -name '*.cc')
  [ -n "$files" ] || { echo "$1 holds no source"; failed=1; return; }
  # shellcheck disable=SC2086 # no path of ours has a space
  wrong=$(grep -HnE '^ *# *include *"(server|client)/' $files | grep -vE "#include \"($2)" || true)
  [ -z "$wrong" ] || { echo "$1 may not include:"; echo "$wrong"; failed=1; }
}
check server/geometry 'server/geometry/'
check server/mesh 'server/(geometry|mesh)/'
check server/tree 'server/(geometry|tree)/'
check server/build 'server/(geometry|mesh|tree|build)/'
check server/store 'server/(geometry|mesh|tree|build|store)/'
check server/service 'server/(geometry|mesh|tree|build|store|service)/'
check client 'client/'

wrong=$(grep -rnE '# *include *[<"](grpc|grpcpp|google/protobuf|deltaray/v1)/' server --include='*.h' --include='*.cc' |
  grep -vE '^server/(service/|main\.cc)' || true)
[ -z "$wrong" ] || { echo "gRPC and the contract stay in server/service:"; echo "$wrong"; failed=1; }

[ $failed -eq 0 ] && echo "all includes go down"
exit $failed
