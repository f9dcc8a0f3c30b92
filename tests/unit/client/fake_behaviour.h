// How the fake server misbehaves.

#ifndef TESTS_UNIT_CLIENT_FAKE_BEHAVIOUR_H_
#define TESTS_UNIT_CLIENT_FAKE_BEHAVIOUR_H_

#include <cstdint>
#include <limits>
#include <string>

#include "deltaray/v1/mesh.pb.h"
#include "grpcpp/support/status.h"

namespace deltaray {

// Set before a call.
struct FakeBehaviour {
  // StreamRays: end with this, or with OK, before reading batch number `fail_at_batch`.
  grpc::Status stream_status;
  uint64_t fail_at_batch = ~uint64_t{0};
  // StreamRays, WatchBuild after its first report, ListMeshes, DeleteMesh and Check: so many calls fail; the first with
  // stream_status, the others with `lost`.
  int stream_failures = std::numeric_limits<int>::max();
  int watch_failures = 0;
  int list_failures = 0;
  int delete_failures = 0;
  int health_failures = 0;
  grpc::Status lost{grpc::StatusCode::UNAVAILABLE, "lost"};
  // StreamRays: the id that each stream after the first one answers for, where not empty.
  std::string moved_mesh;
  // StreamRays: number of the first reply, where not 0 a wrong one.
  uint64_t first_batch_number = 0;
  // StreamRays: added to the count in the trailing metadata.
  uint64_t extra_batches = 0;
  // WatchBuild ends with this state.
  v1::MeshState final_state = v1::MESH_STATE_READY;
  // UploadMesh: so many calls fail with this after the header.
  grpc::Status upload_status;
  int upload_failures = std::numeric_limits<int>::max();
  // ListMeshes: the token of every page, where not empty.
  std::string page_token;
  // UploadMesh, RebuildMesh and DeleteMesh answer without an id.
  bool no_ids = false;
  // ListMeshes sleeps so long.
  int list_delay_ms = 0;
};

}  // namespace deltaray

#endif  // TESTS_UNIT_CLIENT_FAKE_BEHAVIOUR_H_
