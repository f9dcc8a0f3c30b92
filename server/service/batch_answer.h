// From a batch of rays to its reply.

#ifndef SERVER_SERVICE_BATCH_ANSWER_H_
#define SERVER_SERVICE_BATCH_ANSWER_H_

#include <cstdint>

#include "absl/status/statusor.h"
#include "grpcpp/support/slice.h"
#include "server/build/build.h"
#include "server/service/batch_control.h"
#include "server/service/batch_query.h"
#include "server/service/ray_message.h"

namespace deltaray {

struct BatchLimits {
  uint32_t max_rays = 1'048'576;
  uint64_t max_message_bytes = uint64_t{64} << 20;
};

struct BatchAnswer {
  grpc::Slice hits;  // a v1::HitBatch
  AccuracyLevel accuracy = AccuracyLevel::kExact;
  uint64_t ray_count = 0;
  uint64_t hit_count = 0;  // rays that hit; of ALL_HITS and COUNT_HITS the hits in all
};

// Whether a batch, in a message of `bytes`, is so small that it may be answered within a reaction of gRPC, where the
// tree is not growing. All others must be answered on a thread of the Tracer: a reaction that takes long holds up all
// calls of its connection.
bool IsSmall(const BatchQuery& query, size_t bytes);

// Whether it takes a few milliseconds at most, in general: see Tracer::EnqueueShort.
bool IsShort(const BatchQuery& query, size_t bytes);

// The bytes that the answer to a batch in a message of `bytes` can take at most, on its way to the reply and as that.
uint64_t MaxAnswerBytes(const BatchQuery& query, size_t bytes, const BatchLimits& limits);

// Answers a batch: decodes, traces and writes columns piece by piece, spread over the arena of the calling thread.
//
// INVALID_ARGUMENT names the first ray that is malformed. RESOURCE_EXHAUSTED: too many rays, or a reply over the
// message limit; replies of a known size are refused before any ray is traced, ALL_HITS as soon as the hits so far are
// too many. CANCELLED soon after control.cancelled returns true, however long a ray takes.
absl::StatusOr<BatchAnswer> AnswerBatch(const TreeSnapshot& snapshot, const BatchQuery& query,
                                        const RayBatchBytes& batch, const BatchLimits& limits,
                                        const BatchControl& control);

}  // namespace deltaray

#endif  // SERVER_SERVICE_BATCH_ANSWER_H_
