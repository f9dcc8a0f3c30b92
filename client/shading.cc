#include "client/shading.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"
#include "client/hit_column.h"

namespace deltaray {
namespace {

constexpr std::array<uint8_t, 3> kBackground = {24, 28, 38};
// Lambert: brightness of a face turned away from the light, and how much the light adds.
constexpr double kAmbient = 0.03;
constexpr double kDiffuse = 0.7;
// Unit direction to the light along the picture's axes.
constexpr double kLightLeft = 0.48;
constexpr double kLightUp = 0.6;
constexpr double kLightBack = 0.64;

// Linear light, 0 to 1, to sRGB.
uint8_t ToSrgb(double linear) {
  const double x = std::clamp(linear, 0.0, 1.0);
  const double encoded = x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
  return static_cast<uint8_t>(std::lround(255 * encoded));
}

absl::Status BadColumn(absl::string_view name, size_t bytes, uint32_t rays) {
  return LocalError(absl::StrCat("the server's reply has ", bytes, " bytes of ", name, " for ", rays, " rays"));
}

}  // namespace

Shading::Shading(Shade shade, const Camera& camera, uint32_t width, uint32_t height)
    : shade_(shade), camera_(camera), image_{width, height, {}} {
  const size_t pixels = size_t{width} * height;
  image_.rgb.resize(3 * pixels);
  for (size_t i = 0; i < pixels; ++i) std::copy(kBackground.begin(), kBackground.end(), &image_.rgb[3 * i]);
  if (shade == Shade::kDepth) depths_.resize(pixels, std::numeric_limits<float>::infinity());
  // Beside and above the viewer, so that faces turned to the viewer still differ.
  for (int i = 0; i < 3; ++i) {
    light_[i] = kLightUp * camera.up()[i] - kLightLeft * camera.right()[i] - kLightBack * camera.forward()[i];
  }
}

std::vector<v1::HitColumn> Shading::columns() const {
  if (shade_ == Shade::kDepth) return {v1::HIT_COLUMN_T, v1::HIT_COLUMN_PRIMITIVE_ID};
  return {v1::HIT_COLUMN_NORMAL};
}

absl::Status Shading::Add(const v1::HitBatch& hits) {
  if (next_pixel_ + hits.ray_count() > image_.rgb.size() / 3) return LocalError("the server answered too many rays");
  absl::Status status = shade_ == Shade::kDepth ? AddDepths(hits) : AddNormals(hits);
  next_pixel_ += hits.ray_count();
  return status;
}

absl::Status Shading::AddDepths(const v1::HitBatch& hits) {
  if (hits.t().size() != hits.ray_count() * sizeof(float)) return BadColumn("t", hits.t().size(), hits.ray_count());
  if (hits.primitive_id().size() != hits.ray_count() * sizeof(uint32_t)) {
    return BadColumn("primitive_id", hits.primitive_id().size(), hits.ray_count());
  }
  for (uint32_t i = 0; i < hits.ray_count(); ++i) {
    if (RowAt<uint32_t>(hits.primitive_id(), i) == kNoId) continue;
    ++hit_count_;
    // A hit beyond float's range has an infinite t too.
    constexpr float kFarthest = std::numeric_limits<float>::max();
    depths_[next_pixel_ + i] = std::clamp(RowAt<float>(hits.t(), i), -kFarthest, kFarthest);
  }
  return absl::OkStatus();
}

absl::Status Shading::AddNormals(const v1::HitBatch& hits) {
  if (hits.normal().size() != hits.ray_count() * 3 * sizeof(float)) {
    return BadColumn("normal", hits.normal().size(), hits.ray_count());
  }
  for (uint32_t i = 0; i < hits.ray_count(); ++i) {
    const auto n = RowAt<std::array<float, 3>>(hits.normal(), i);
    if (n == std::array<float, 3>{}) continue;  // a miss: normals of hits have length 1
    ++hit_count_;
    const uint64_t pixel = next_pixel_ + i;
    if (shade_ == Shade::kNormal) {
      for (int c = 0; c < 3; ++c) image_.rgb[3 * pixel + c] = std::lround(255 * std::clamp(0.5 + 0.5 * n[c], 0.0, 1.0));
      continue;
    }
    Vec3 normal = {n[0], n[1], n[2]};
    const Vec3 ray = camera_.Direction(pixel % image_.width, pixel / image_.width);
    if (Dot(normal, ray) > 0) normal = {-normal[0], -normal[1], -normal[2]};
    const double light = kAmbient + kDiffuse * std::max(0.0, Dot(normal, light_));
    std::fill_n(&image_.rgb[3 * pixel], 3, ToSrgb(light));
  }
  return absl::OkStatus();
}

Image Shading::Finish() {
  if (shade_ != Shade::kDepth || hit_count_ == 0) return std::move(image_);
  // In double, where differences of floats do not overflow.
  double nearest = std::numeric_limits<double>::infinity();
  double farthest = -std::numeric_limits<double>::infinity();
  for (const double t : depths_) {
    if (!std::isfinite(t)) continue;
    nearest = std::min(nearest, t);
    farthest = std::max(farthest, t);
  }
  const double range = farthest > nearest ? farthest - nearest : 1;
  for (size_t pixel = 0; pixel < depths_.size(); ++pixel) {
    if (!std::isfinite(depths_[pixel])) continue;
    const double part = (depths_[pixel] - nearest) / range;
    std::fill_n(&image_.rgb[3 * pixel], 3, static_cast<uint8_t>(std::lround(240 - 180 * part)));
  }
  return std::move(image_);
}

}  // namespace deltaray
