#include "server/service/ray_batch.h"

#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

static_assert(std::endian::native == std::endian::little, "rays are copied from the wire as they are");

// What is wrong with a ray whose numbers, as sent and as rounded, are these. Called only where something is.
template <typename Scalar>
absl::Status Fault(size_t index, const Scalar* sent, int numbers, const Ray& ray) {
  static constexpr const char* kNames[] = {"origin.x",    "origin.y",    "origin.z", "direction.x",
                                           "direction.y", "direction.z", "t_min",    "t_max"};
  const auto fault = [index](const char* name, const char* what) {
    return absl::InvalidArgumentError(absl::StrCat("rays.rays: ray ", index, ": ", name, " ", what));
  };
  for (int i = 0; i < numbers; ++i) {
    if (std::isnan(sent[i])) return fault(kNames[i], "is NaN");
    if (i < 6 && std::isinf(sent[i])) return fault(kNames[i], "is infinite");
  }
  for (int i = 0; i < 6; ++i) {
    const float rounded = i < 3 ? ray.origin[i] : ray.direction[i - 3];
    if (!std::isfinite(rounded)) {
      return fault(kNames[i], i < 3 ? "is out of the range of float32, relative to the mesh's origin"
                                    : "is out of the range of float32");
    }
  }
  return fault("direction", "is too short for float32, in which it is zero");
}

}  // namespace

absl::StatusOr<RayBatchView> RayBatchView::Make(const v1::RayBatch& batch, const BatchQuery& query, Vec3d mesh_origin,
                                                uint32_t max_rays) {
  RayBatchView view;
  const size_t ray_bytes = query.RayBytes();
  if (batch.rays().size() % ray_bytes != 0) {
    return absl::InvalidArgumentError(absl::StrCat("rays.rays: ", batch.rays().size(), " bytes are not a multiple of ",
                                                   ray_bytes, ", the bytes of a ray in ",
                                                   v1::RayLayout_Name(query.layout)));
  }
  view.size_ = batch.rays().size() / ray_bytes;
  if (view.size_ > max_rays) {
    return absl::ResourceExhaustedError(
        absl::StrCat("rays.rays: ", view.size_, " rays are over the limit of ", max_rays, " rays a batch"));
  }
  const std::string& excluded = batch.excluded_primitive_ids();
  if (!excluded.empty() && excluded.size() != view.size_ * sizeof(uint32_t)) {
    return absl::InvalidArgumentError(absl::StrCat("rays.excluded_primitive_ids: ", excluded.size(), " bytes, not ",
                                                   view.size_ * sizeof(uint32_t), " for ", view.size_, " rays"));
  }
  view.rays_ = batch.rays().data();
  view.excluded_ = excluded.empty() ? nullptr : excluded.data();
  view.layout_ = query.layout;
  view.t_min_ = query.t_min;
  view.t_max_ = query.t_max;
  view.mesh_origin_ = mesh_origin;
  return view;
}

absl::Status RayBatchView::Decode(size_t first, std::span<Ray> rays) const {
  switch (layout_) {
    case v1::RAY_LAYOUT_FLOAT32X8:
      return DecodeAs<float, true>(first, rays);
    case v1::RAY_LAYOUT_FLOAT64X6:
      return DecodeAs<double, false>(first, rays);
    case v1::RAY_LAYOUT_FLOAT64X8:
      return DecodeAs<double, true>(first, rays);
    default:
      return DecodeAs<float, false>(first, rays);
  }
}

template <typename Scalar, bool kInterval>
absl::Status RayBatchView::DecodeAs(size_t first, std::span<Ray> rays) const {
  constexpr int kNumbers = kInterval ? 8 : 6;
  for (size_t i = 0; i < rays.size(); ++i) {
    Scalar sent[kNumbers];
    std::memcpy(sent, rays_ + (first + i) * sizeof(sent), sizeof(sent));
    Ray& ray = rays[i];
    ray = Ray();
    ray.origin = static_cast<Vec3f>(Vec3d{sent[0], sent[1], sent[2]} - mesh_origin_);
    ray.direction = static_cast<Vec3f>(Vec3<Scalar>{sent[3], sent[4], sent[5]});
    bool good = IsFinite(ray.origin) && IsFinite(ray.direction);
    if constexpr (kInterval) {
      ray.t_min = static_cast<float>(sent[6]);
      ray.t_max = static_cast<float>(sent[7]);
      good = good && !std::isnan(ray.t_min) && !std::isnan(ray.t_max);
    } else {
      ray.t_min = t_min_;
      ray.t_max = t_max_;
    }
    if constexpr (sizeof(Scalar) > sizeof(float)) {
      // A direction that only rounding made zero would turn hits into misses without a word.
      good = good && (ray.direction != Vec3f() || (sent[3] == 0 && sent[4] == 0 && sent[5] == 0));
    }
    if (!good) return Fault(first + i, sent, kNumbers, ray);
    if (excluded_ != nullptr) {
      std::memcpy(&ray.excluded_primitive, excluded_ + (first + i) * sizeof(uint32_t), sizeof(uint32_t));
    }
  }
  return absl::OkStatus();
}

}  // namespace deltaray
