// From hits to a picture.

#ifndef CLIENT_SHADING_H_
#define CLIENT_SHADING_H_

#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "client/camera.h"
#include "client/png_image.h"
#include "deltaray/v1/ray_service.pb.h"

namespace deltaray {

enum class Shade {
  // Colour by the geometric normal: x, y, z from -1 to 1 give red, green, blue.
  kNormal,
  // Grey by distance, from the nearest hit, light, to the farthest, dark.
  kDepth,
  // Matte grey under a light at the viewer's upper left; both sides of a triangle look alike.
  kLambert,
};

// Collects the closest hits of a picture's rays, one ray a pixel, rows from the top. Pixels without a hit are dark
// blue.
class Shading {
 public:
  Shading(Shade shade, const Camera& camera, uint32_t width, uint32_t height);

  // The columns that this shade needs.
  std::vector<v1::HitColumn> columns() const;

  // Takes the hits of the next rays. A LocalError where a column has the wrong length.
  absl::Status Add(const v1::HitBatch& hits);

  // Rays that hit so far.
  uint64_t hit_count() const { return hit_count_; }

  // The picture. Call it once, after all pixels are added.
  Image Finish();

 private:
  absl::Status AddDepths(const v1::HitBatch& hits);
  absl::Status AddNormals(const v1::HitBatch& hits);

  const Shade shade_;
  const Camera camera_;
  Image image_;
  // Unit direction to the light.
  Vec3 light_;
  // Distance of each pixel, infinite where there is no hit; only for kDepth.
  std::vector<float> depths_;
  uint64_t next_pixel_ = 0;
  uint64_t hit_count_ = 0;
};

}  // namespace deltaray

#endif  // CLIENT_SHADING_H_
