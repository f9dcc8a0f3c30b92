// Streams batches of rays to the server and takes the replies, both at once.

#ifndef CLIENT_RAY_STREAM_H_
#define CLIENT_RAY_STREAM_H_

#include <cstdint>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/connection.h"

namespace deltaray {

// Batches that may be sent and not yet answered: enough to keep the server's read-ahead full while replies travel.
constexpr int kStreamWindow = 8;

// A batch to send.
struct OutgoingBatch {
  v1::RayBatch rays;
  uint32_t ray_count = 0;
};

// Fills in the next batch; returns false once there is none. Runs on a thread of its own.
using NextBatch = absl::FunctionRef<absl::StatusOr<bool>(OutgoingBatch&)>;

// Takes the answer to the next batch. Runs on the calling thread, in order.
using TakeHits = absl::FunctionRef<absl::Status(const v1::HitBatch&)>;

// Streams all batches. The first error of `next`, of `take` or of the RPC ends it and is returned; no thread and no RPC
// is left behind. Checks what the server answers against what was asked: batch numbers, ray counts, the mesh, that all
// batches are answered, and the trailing metadata `deltaray-batches`.
//
// Where the server refuses a batch, the error also tells which ray of the whole input the batch begins with.
//
// A stream that is lost with its server is resumed, by the rules of Retry: a new RPC begins with the first batch that
// is not answered, for the mesh id of the answers so far. Each batch is answered once, in order, all of one mesh.
absl::Status StreamBatches(Connection& connection, const v1::StreamStart& start, NextBatch next, TakeHits take);

}  // namespace deltaray

#endif  // CLIENT_RAY_STREAM_H_
