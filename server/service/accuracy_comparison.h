// One batch of rays at each accuracy level: what each costs, and how often it is wrong.

#ifndef SERVER_SERVICE_ACCURACY_COMPARISON_H_
#define SERVER_SERVICE_ACCURACY_COMPARISON_H_

#include <cstdint>
#include <functional>

#include "absl/status/statusor.h"
#include "deltaray/v1/ray_service.pb.h"
#include "server/build/build.h"
#include "server/service/batch_control.h"
#include "server/service/batch_query.h"
#include "server/service/ray_message.h"

namespace deltaray {

// What a v1::CompareAccuracyRequest asks, checked.
struct ComparisonQuery {
  BatchQuery query;  // CLOSEST_HIT or ANY_HIT
  uint32_t rounds = 5;
};

// INVALID_ARGUMENT, naming the field, where ray_service.proto does not allow a value.
absl::StatusOr<ComparisonQuery> ReadComparison(const v1::CompareAccuracyRequest& request);

// Runs the rays at each level, spread over the arena of the calling thread, which must be one of the tracer: once to
// compare, then in rounds to measure the time. Errors are those of AnswerBatch; INVALID_ARGUMENT where there are no
// rays. Fills in all of the response but the mesh's id.
absl::StatusOr<v1::CompareAccuracyResponse> CompareAccuracy(const TreeSnapshot& snapshot,
                                                            const ComparisonQuery& comparison,
                                                            const RayBatchBytes& batch, uint32_t max_rays,
                                                            const BatchControl& control);

}  // namespace deltaray

#endif  // SERVER_SERVICE_ACCURACY_COMPARISON_H_
