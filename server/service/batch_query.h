// What a request asks of every ray, checked.

#ifndef SERVER_SERVICE_BATCH_QUERY_H_
#define SERVER_SERVICE_BATCH_QUERY_H_

#include <cstddef>
#include <cstdint>

#include "absl/status/statusor.h"
#include "deltaray/v1/ray_service.pb.h"
#include "server/tree/tree.h"

namespace deltaray {

// A v1::RayQuery without anything unspecified.
struct BatchQuery {
  v1::QueryKind kind = v1::QUERY_KIND_CLOSEST_HIT;
  v1::RayLayout layout = v1::RAY_LAYOUT_FLOAT32X6;
  // Bit i: the column HitColumn i is wanted.
  uint32_t columns = 0;
  QueryOptions options;
  // The interval of t for layouts without one.
  float t_min = 0;
  float t_max = 0;
  bool wait_final = false;

  bool Wants(v1::HitColumn column) const { return (columns >> column & 1) != 0; }
  // Bytes of one ray in `layout`.
  size_t RayBytes() const;
};

// INVALID_ARGUMENT, naming the field as `query.<field>`, where a value is not one that ray_service.proto allows.
absl::StatusOr<BatchQuery> ReadQuery(const v1::RayQuery& query);

}  // namespace deltaray

#endif  // SERVER_SERVICE_BATCH_QUERY_H_
