#include "client/camera.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "client/exit_code.h"

namespace deltaray {
namespace {

// The framed view: this far round the up axis, and this far above the horizon.
constexpr double kAzimuthDegrees = 35;
constexpr double kElevationDegrees = 20;
// Free space about the framed mesh, as a part of the distance.
constexpr double kMargin = 0.05;

constexpr double kDegree = std::numbers::pi / 180;

// The axes of the picture: unit vectors, at right angles.
struct View {
  Vec3 right;
  Vec3 up;
  Vec3 forward;
};

absl::StatusOr<View> MakeView(const Vec3& forward, const Vec3& up) {
  View view;
  view.forward = forward;
  const Vec3 right = Cross(forward, Normalize(up));
  if (!(Length(right) > 1e-9)) return UsageError("--up is parallel to the direction from --eye to --target");
  view.right = Normalize(right);
  view.up = Cross(view.right, forward);
  return view;
}

// The direction of the three-quarter view, from the camera to the target. Front is the axis after up (z for y up), made
// perpendicular to up.
Vec3 ThreeQuarterDirection(const Vec3& up_option) {
  const Vec3 up = Normalize(up_option);
  const size_t main_axis =
      std::max_element(up.begin(), up.end(), [](double a, double b) { return std::abs(a) < std::abs(b); }) - up.begin();
  Vec3 front = {0, 0, 0};
  // For y up the front of models is +z by convention, for z up it is -y: both give the same picture.
  front[main_axis == 1 ? 2 : (main_axis + 2) % 3] = main_axis == 1 ? 1 : -1;
  front = Normalize(Subtract(front, Scale(up, Dot(front, up))));
  const Vec3 side = Cross(up, front);
  const double azimuth = kAzimuthDegrees * kDegree;
  const double elevation = kElevationDegrees * kDegree;
  const Vec3 level = Add(Scale(front, std::cos(azimuth)), Scale(side, std::sin(azimuth)));
  return Scale(Add(Scale(level, std::cos(elevation)), Scale(up, std::sin(elevation))), -1);
}

// Least distance from the target at which all corners of the bounds are inside the picture.
double FramingDistance(const View& view, const Vec3& target, const Vec3& low, const Vec3& high, double half_width,
                       double half_height) {
  double distance = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const Vec3 point = {corner & 1 ? high[0] : low[0], corner & 2 ? high[1] : low[1], corner & 4 ? high[2] : low[2]};
    const Vec3 offset = Subtract(point, target);
    const double needed =
        std::max(std::abs(Dot(offset, view.right)) / half_width, std::abs(Dot(offset, view.up)) / half_height);
    distance = std::max(distance, needed - Dot(offset, view.forward));
  }
  return distance;
}

}  // namespace

absl::StatusOr<Camera> Camera::Place(const CameraOptions& options, const v1::Mesh& mesh) {
  const bool framed = !options.eye.has_value();
  if (!mesh.has_bounds() && (framed || !options.target)) {
    return UsageError("the mesh is empty, so that the camera needs both --eye and --target");
  }
  if (Length(options.up) == 0) return UsageError("--up has length 0");
  const Vec3 low = FromPoint(mesh.bounds().min());
  const Vec3 high = FromPoint(mesh.bounds().max());
  const Vec3 target = options.target.value_or(Add(Scale(low, 0.5), Scale(high, 0.5)));

  // Half of the picture's size at distance 1.
  const double half_height = std::tan(options.fov_degrees * kDegree / 2);
  const double half_width = half_height * options.width / options.height;

  Vec3 forward;
  if (framed) {
    forward = ThreeQuarterDirection(options.up);
  } else {
    const Vec3 difference = Subtract(target, *options.eye);
    if (Length(difference) == 0) return UsageError("--eye and --target are the same point");
    forward = Normalize(difference);
  }
  const absl::StatusOr<View> view = MakeView(forward, options.up);
  if (!view.ok()) return view.status();

  Camera camera;
  if (framed) {
    double distance = FramingDistance(*view, target, low, high, half_width, half_height) * (1 + kMargin);
    // A mesh of a single point is seen from anywhere.
    if (distance == 0) distance = 1;
    camera.eye_ = Subtract(target, Scale(forward, distance));
  } else {
    camera.eye_ = *options.eye;
  }
  camera.right_ = view->right;
  camera.up_ = view->up;
  camera.forward_ = view->forward;
  camera.step_right_ = Scale(view->right, 2 * half_width / options.width);
  camera.step_down_ = Scale(view->up, -2 * half_height / options.height);
  const Vec3 edge = Add(forward, Add(Scale(view->right, -half_width), Scale(view->up, half_height)));
  camera.corner_ = Add(edge, Scale(Add(camera.step_right_, camera.step_down_), 0.5));
  return camera;
}

Vec3 Camera::Direction(uint32_t column, uint32_t row) const {
  return Normalize(Add(corner_, Add(Scale(step_right_, column), Scale(step_down_, row))));
}

}  // namespace deltaray
