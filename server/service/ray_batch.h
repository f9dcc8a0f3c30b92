// A checked view of the rays of a request.

#ifndef SERVER_SERVICE_RAY_BATCH_H_
#define SERVER_SERVICE_RAY_BATCH_H_

#include <cstddef>
#include <cstdint>
#include <span>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/geometry/ray.h"
#include "server/mesh/triangle_mesh.h"
#include "server/service/batch_query.h"
#include "server/service/ray_message.h"

namespace deltaray {

// The rays of a batch, turned into the coordinates of the mesh piece by piece, so that the pieces of a batch can be
// turned by several threads and no copy of the batch is needed. The bytes need no alignment. Thread-safe.
class RayBatchView {
 public:
  // A view of `batch`, which must outlive it, for `mesh`. INVALID_ARGUMENT where an array is not a whole number of rays
  // long; RESOURCE_EXHAUSTED for more than `max_rays` rays. Says nothing on the numbers in it: Decode does.
  static absl::StatusOr<RayBatchView> Make(const RayBatchBytes& batch, const BatchQuery& query,
                                           const TriangleMesh& mesh, uint32_t max_rays);

  size_t size() const { return size_; }

  // Most rays that one call of Decode takes.
  static constexpr size_t kMaxPieceRays = 1024;

  // Fills `rays` with the rays from `first` on. The mesh's origin is subtracted from the ray's in float64, and the
  // result rounded once to float32; where it is zero, float32 rays keep their bits. INVALID_ARGUMENT, with the number
  // of the ray and the component, for a number that is not finite, or no longer so as float32, for a direction that
  // float32 cannot tell from zero, for NaN in an interval, and for an excluded primitive that the mesh has not.
  absl::Status Decode(size_t first, std::span<Ray> rays) const;

 private:
  explicit RayBatchView(const RayBatchBytes* batch) : batch_(batch) {}

  template <typename Scalar, bool kInterval, bool kMove>
  absl::Status DecodeAs(size_t first, std::span<Ray> rays) const;

  const RayBatchBytes* batch_;
  size_t size_ = 0;
  v1::RayLayout layout_ = v1::RAY_LAYOUT_FLOAT32X6;
  float t_min_ = 0;
  float t_max_ = 0;
  Vec3d mesh_origin_;
  uint32_t triangle_count_ = 0;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_RAY_BATCH_H_
