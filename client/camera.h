// A pinhole camera: where its rays go, and how it is framed on a mesh.

#ifndef CLIENT_CAMERA_H_
#define CLIENT_CAMERA_H_

#include <cstdint>
#include <optional>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/vec3.h"
#include "deltaray/v1/mesh.pb.h"

namespace deltaray {

// What the user gave. Lengths are in the unit of the mesh file.
struct CameraOptions {
  // Where the camera stands. Unset: chosen so that the whole mesh is seen.
  std::optional<Vec3> eye;
  // Where it looks. Unset: the centre of the mesh's bounds.
  std::optional<Vec3> target;
  // The direction that is up in the picture; any length but 0.
  Vec3 up = {0, 1, 0};
  // Vertical field of view in degrees, above 0 and below 180.
  double fov_degrees = 40;
  // Size of the picture in pixels, at least 1 × 1.
  uint32_t width = 640;
  uint32_t height = 480;
};

class Camera {
 public:
  // Places the camera. Where no eye is given, it looks from three quarters, from the right and somewhat above, as near
  // as shows all of the mesh's bounds with a small margin. Fails, as a usage error, where eye and target coincide or up
  // is parallel to the view, and where the mesh is empty but needed for framing.
  static absl::StatusOr<Camera> Place(const CameraOptions& options, const v1::Mesh& mesh);

  const Vec3& eye() const { return eye_; }

  // Axes of the picture in space: unit vectors at right angles.
  const Vec3& right() const { return right_; }
  const Vec3& up() const { return up_; }
  const Vec3& forward() const { return forward_; }

  // Unit direction of the ray through the centre of a pixel; (0, 0) is the top left one.
  Vec3 Direction(uint32_t column, uint32_t row) const;

 private:
  Vec3 eye_;
  Vec3 right_;
  Vec3 up_;
  Vec3 forward_;
  // Through the centre of the top left pixel, and from one pixel's centre to the next.
  Vec3 corner_;
  Vec3 step_right_;
  Vec3 step_down_;
};

}  // namespace deltaray

#endif  // CLIENT_CAMERA_H_
