// Requests that carry rays, parsed without a copy of the rays.

#ifndef SERVER_SERVICE_RAY_MESSAGE_H_
#define SERVER_SERVICE_RAY_MESSAGE_H_

#include <cstddef>

#include "absl/status/status.h"
#include "deltaray/v1/ray_service.pb.h"
#include "grpcpp/support/byte_buffer.h"
#include "server/service/message_fields.h"
#include "server/service/message_slices.h"

namespace deltaray {

// The two arrays of a v1::RayBatch, where they lie in the message that it arrived in.
struct RayBatchBytes {
  MessageSlices message;
  MessageRange rays;
  MessageRange excluded_primitive_ids;
};

// Parses `bytes`. The rays, of which there are most bytes by far, go to `rays` and not to request->rays(), of which
// only whether it is set tells something. INVALID_ARGUMENT, as ParseMessage says, where `bytes` are no such message;
// RESOURCE_EXHAUSTED where they are more than kMaxSmallMessageBytes besides the arrays.
absl::Status ParseRayMessage(grpc::ByteBuffer bytes, v1::CastRaysRequest* request, RayBatchBytes* rays);
absl::Status ParseRayMessage(grpc::ByteBuffer bytes, v1::CompareAccuracyRequest* request, RayBatchBytes* rays);
absl::Status ParseRayMessage(grpc::ByteBuffer bytes, v1::StreamRaysRequest* request, RayBatchBytes* rays);

// The arrays of `batch`, copied.
RayBatchBytes CopyRayBatch(const v1::RayBatch& batch);

}  // namespace deltaray

#endif  // SERVER_SERVICE_RAY_MESSAGE_H_
