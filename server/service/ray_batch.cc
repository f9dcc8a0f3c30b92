#include "server/service/ray_batch.h"

#include <bit>
#include <cmath>
#include <cstddef>
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

// Whether only rounding made a direction zero.
bool IsTooShort(double x, double y, double z, Vec3f rounded) {
  return rounded == Vec3f() && (x != 0 || y != 0 || z != 0);
}

// Tells by a few operations a ray whether its numbers are what they must be, so that it need not be told for each one
// of them: the bits of a number without its sign, as an integer, grow with its magnitude, and those of infinity are
// below those of any NaN.
class NumberCheck {
 public:
  void Add(const Ray& ray) {
    static_assert(offsetof(Ray, t_min) == 12 && offsetof(Ray, direction) == 16 && offsetof(Ray, t_max) == 28);
    int32_t bits[kNumbers];
    std::memcpy(bits, &ray, sizeof(bits));
    for (size_t i = 0; i < kNumbers; ++i) wrong_[i] |= kLargest[i] - (bits[i] & 0x7FFFFFFF);
  }

  // Whether in all rays added origin and direction are finite and no end of the interval is NaN.
  bool good() const {
    int32_t wrong = 0;
    for (const int32_t w : wrong_) wrong |= w;
    return wrong >= 0;
  }

 private:
  static constexpr size_t kNumbers = 8;
  static constexpr int32_t kMax = 0x7F7FFFFF, kInfinity = 0x7F800000;
  static constexpr int32_t kLargest[kNumbers] = {kMax, kMax, kMax, kInfinity, kMax, kMax, kMax, kInfinity};
  int32_t wrong_[kNumbers] = {};  // negative: some number was larger than kLargest
};

}  // namespace

absl::StatusOr<RayBatchView> RayBatchView::Make(const RayBatchBytes& batch, const BatchQuery& query,
                                                const TriangleMesh& mesh, uint32_t max_rays) {
  RayBatchView view(&batch);
  const size_t ray_bytes = query.RayBytes();
  if (batch.rays.size % ray_bytes != 0) {
    return absl::InvalidArgumentError(absl::StrCat("rays.rays: ", batch.rays.size, " bytes are not a multiple of ",
                                                   ray_bytes, ", the bytes of a ray in ",
                                                   v1::RayLayout_Name(query.layout)));
  }
  view.size_ = batch.rays.size / ray_bytes;
  if (view.size_ > max_rays) {
    return absl::ResourceExhaustedError(absl::StrCat("rays.rays: ", view.size_, " rays are over the limit of ",
                                                     max_rays, " rays a batch (--max-batch-rays)"));
  }
  const size_t excluded = batch.excluded_primitive_ids.size;
  if (excluded != 0 && excluded != view.size_ * sizeof(uint32_t)) {
    return absl::InvalidArgumentError(absl::StrCat("rays.excluded_primitive_ids: ", excluded, " bytes, not ",
                                                   view.size_ * sizeof(uint32_t), " for ", view.size_, " rays"));
  }
  view.layout_ = query.layout;
  view.t_min_ = query.t_min;
  view.t_max_ = query.t_max;
  view.mesh_origin_ = mesh.origin;
  view.triangle_count_ = static_cast<uint32_t>(mesh.indices.size());
  return view;
}

absl::Status RayBatchView::Decode(size_t first, std::span<Ray> rays) const {
  const bool move = mesh_origin_ != Vec3d();
  switch (layout_) {
    case v1::RAY_LAYOUT_FLOAT32X8:
      return move ? DecodeAs<float, true, true>(first, rays) : DecodeAs<float, true, false>(first, rays);
    case v1::RAY_LAYOUT_FLOAT64X6:
      return DecodeAs<double, false, true>(first, rays);
    case v1::RAY_LAYOUT_FLOAT64X8:
      return DecodeAs<double, true, true>(first, rays);
    default:
      return move ? DecodeAs<float, false, true>(first, rays) : DecodeAs<float, false, false>(first, rays);
  }
}

template <typename Scalar, bool kInterval, bool kMove>
absl::Status RayBatchView::DecodeAs(size_t first, std::span<Ray> rays) const {
  constexpr int kNumbers = kInterval ? 8 : 6;
  constexpr size_t kRayBytes = kNumbers * sizeof(Scalar);
  char scratch[kMaxPieceRays * kRayBytes], excluded_scratch[kMaxPieceRays * sizeof(uint32_t)];
  const char* const bytes =
      batch_->message.Read(batch_->rays.offset + first * kRayBytes, rays.size() * kRayBytes, scratch);
  const auto read = [bytes](size_t i, Scalar(&sent)[kNumbers]) { std::memcpy(sent, bytes + i * kRayBytes, kRayBytes); };

  NumberCheck check;
  bool too_short = false;
  for (size_t i = 0; i < rays.size(); ++i) {
    Scalar sent[kNumbers];
    read(i, sent);
    Ray& ray = rays[i];
    if constexpr (kMove) {
      ray.origin = static_cast<Vec3f>(Vec3d{sent[0], sent[1], sent[2]} - mesh_origin_);
    } else {
      ray.origin = {sent[0], sent[1], sent[2]};
    }
    ray.direction = static_cast<Vec3f>(Vec3<Scalar>{sent[3], sent[4], sent[5]});
    ray.t_min = kInterval ? static_cast<float>(sent[kNumbers - 2]) : t_min_;
    ray.t_max = kInterval ? static_cast<float>(sent[kNumbers - 1]) : t_max_;
    ray.excluded_primitive = kNoPrimitive;
    check.Add(ray);
    if constexpr (sizeof(Scalar) > sizeof(float)) {
      // A direction that only rounding made zero would turn hits into misses without a word.
      too_short |= IsTooShort(sent[3], sent[4], sent[5], ray.direction);
    }
  }
  if (!check.good() || too_short) {
    for (size_t i = 0;; ++i) {
      Scalar sent[kNumbers];
      read(i, sent);
      NumberCheck one;
      one.Add(rays[i]);
      if (!one.good() || IsTooShort(sent[3], sent[4], sent[5], rays[i].direction)) {
        return Fault(first + i, sent, kNumbers, rays[i]);
      }
    }
  }
  if (batch_->excluded_primitive_ids.size != 0) {
    const char* const excluded = batch_->message.Read(batch_->excluded_primitive_ids.offset + first * sizeof(uint32_t),
                                                      rays.size() * sizeof(uint32_t), excluded_scratch);
    for (size_t i = 0; i < rays.size(); ++i) {
      uint32_t& id = rays[i].excluded_primitive;
      std::memcpy(&id, excluded + i * sizeof(uint32_t), sizeof(uint32_t));
      if (id >= triangle_count_ && id != kNoPrimitive) {
        return absl::InvalidArgumentError(absl::StrCat("rays.excluded_primitive_ids: ray ", first + i, ": ", id,
                                                       " is no triangle of the mesh, which has ", triangle_count_, "; ",
                                                       kNoPrimitive, " stands for none"));
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace deltaray
