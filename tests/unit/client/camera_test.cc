#include "client/camera.h"

#include <gtest/gtest.h>

#include <cmath>

#include "client/exit_code.h"

namespace deltaray {
namespace {

v1::Mesh BoxMesh(const Vec3& low, const Vec3& high) {
  v1::Mesh mesh;
  v1::Point& min = *mesh.mutable_bounds()->mutable_min();
  min.set_x(low[0]);
  min.set_y(low[1]);
  min.set_z(low[2]);
  v1::Point& max = *mesh.mutable_bounds()->mutable_max();
  max.set_x(high[0]);
  max.set_y(high[1]);
  max.set_z(high[2]);
  return mesh;
}

double Dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec3 Minus(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

// Where a point is in the picture, in pixels, found by solving for the ray through it: eye + s * (corner + ...).
std::array<double, 2> Project(const Camera& camera, const CameraOptions& options, const Vec3& point) {
  // Directions have length 1; scaled to the plane at distance 1 before the camera, they are affine in column and row.
  const Vec3 left = camera.Direction(0, 0);
  const Vec3 right = camera.Direction(options.width - 1, 0);
  const Vec3 bottom = camera.Direction(0, options.height - 1);
  const Vec3 opposite = camera.Direction(options.width - 1, options.height - 1);
  Vec3 forward;
  for (int i = 0; i < 3; ++i) forward[i] = left[i] + right[i] + bottom[i] + opposite[i];
  const double length = std::sqrt(Dot(forward, forward));
  for (double& x : forward) x /= length;
  const auto on_plane = [&](Vec3 v) {
    const double depth = Dot(v, forward);
    for (double& x : v) x /= depth;
    return v;
  };
  const Vec3 offset = on_plane(Minus(point, camera.eye()));
  const Vec3 origin = on_plane(left);
  const Vec3 across = Minus(on_plane(right), origin);
  const Vec3 down = Minus(on_plane(bottom), origin);
  const Vec3 relative = Minus(offset, origin);
  return {Dot(relative, across) / Dot(across, across) * (options.width - 1),
          Dot(relative, down) / Dot(down, down) * (options.height - 1)};
}

TEST(CameraTest, GivenCameraLooksWhereItIsTold) {
  CameraOptions options;
  options.eye = Vec3{0, 0, 5};
  options.target = Vec3{0, 0, 0};
  options.fov_degrees = 90;
  options.width = 3;
  options.height = 3;
  const absl::StatusOr<Camera> camera = Camera::Place(options, v1::Mesh());
  ASSERT_TRUE(camera.ok());
  EXPECT_EQ(camera->eye(), (Vec3{0, 0, 5}));
  const Vec3 center = camera->Direction(1, 1);
  EXPECT_NEAR(center[0], 0, 1e-15);
  EXPECT_NEAR(center[1], 0, 1e-15);
  EXPECT_NEAR(center[2], -1, 1e-15);
  // The top left pixel's centre is 2/3 left and up at distance 1.
  const Vec3 corner = camera->Direction(0, 0);
  EXPECT_NEAR(corner[0] / corner[2], 2.0 / 3, 1e-12);
  EXPECT_NEAR(corner[1] / -corner[2], 2.0 / 3, 1e-12);
  EXPECT_LT(corner[0], 0);
  EXPECT_NEAR(Dot(corner, corner), 1, 1e-12);
}

TEST(CameraTest, FramesAllCornersTightly) {
  const Vec3 boxes[][2] = {{{-1, -1, -1}, {1, 1, 1}},
                           {{0, 0, 0}, {10, 0.1, 3}},
                           {{-1e-6, 5, 5}, {1e-6, 5.00001, 5}},
                           {{500000, 5400000, 0}, {500100, 5400300, 40}}};
  const Vec3 ups[] = {{0, 1, 0}, {0, 0, 3}, {1, 0, 0}, {0.5, -1, 0.2}};
  for (const auto& box : boxes) {
    for (const Vec3& up : ups) {
      for (const uint32_t width : {64u, 640u}) {
        CameraOptions options;
        options.up = up;
        options.width = width;
        options.height = 480;
        const absl::StatusOr<Camera> camera = Camera::Place(options, BoxMesh(box[0], box[1]));
        ASSERT_TRUE(camera.ok()) << camera.status();
        double fill = 0;
        for (int corner = 0; corner < 8; ++corner) {
          const Vec3 point = {box[corner & 1][0], box[corner >> 1 & 1][1], box[corner >> 2 & 1][2]};
          const auto [column, row] = Project(*camera, options, point);
          EXPECT_GE(column, -0.5);
          EXPECT_LE(column, options.width - 0.5);
          EXPECT_GE(row, -0.5);
          EXPECT_LE(row, options.height - 0.5);
          fill = std::max(
              {fill, std::abs(column / (options.width - 1) - 0.5) * 2, std::abs(row / (options.height - 1) - 0.5) * 2});
        }
        EXPECT_GT(fill, 0.75);
      }
    }
  }
}

TEST(CameraTest, FramedViewIsFromTheRightFrontAndAbove) {
  const absl::StatusOr<Camera> y_up = Camera::Place({}, BoxMesh({-1, -1, -1}, {1, 1, 1}));
  EXPECT_GT(y_up->eye()[0], 0.5);
  EXPECT_GT(y_up->eye()[1], 0.5);
  EXPECT_GT(y_up->eye()[2], 0.5);
  CameraOptions z_up;
  z_up.up = {0, 0, 1};
  const absl::StatusOr<Camera> camera = Camera::Place(z_up, BoxMesh({-1, -1, -1}, {1, 1, 1}));
  EXPECT_GT(camera->eye()[0], 0.5);
  EXPECT_LT(camera->eye()[1], -0.5);
  EXPECT_GT(camera->eye()[2], 0.5);
}

TEST(CameraTest, SinglePointCanBeFramed) {
  const absl::StatusOr<Camera> camera = Camera::Place({}, BoxMesh({2, 3, 4}, {2, 3, 4}));
  ASSERT_TRUE(camera.ok());
  const Vec3 offset = Minus(camera->eye(), {2, 3, 4});
  EXPECT_NEAR(Dot(offset, offset), 1, 1e-12);
}

TEST(CameraTest, OnlyTheDirectionOfUpCounts) {
  const v1::Mesh mesh = BoxMesh({-1, -1, -1}, {1, 1, 1});
  const absl::StatusOr<Camera> unit = Camera::Place({}, mesh);
  for (const double length : {1e-320, 1e-200, 1e200, 1e308}) {
    CameraOptions options;
    options.up = {0, length, 0};
    const absl::StatusOr<Camera> camera = Camera::Place(options, mesh);
    ASSERT_TRUE(camera.ok()) << camera.status();
    EXPECT_EQ(camera->eye(), unit->eye()) << length;
    EXPECT_EQ(camera->Direction(3, 5), unit->Direction(3, 5)) << length;
  }
}

TEST(CameraTest, RefusesWhatHasNoPicture) {
  const v1::Mesh mesh = BoxMesh({-1, -1, -1}, {1, 1, 1});
  CameraOptions options;
  EXPECT_EQ(ExitCode(Camera::Place(options, v1::Mesh()).status()), kExitUsage);
  options.eye = Vec3{0, 0, 0};
  EXPECT_EQ(Camera::Place(options, mesh).status().message(), "--eye and --target are the same point");
  options.eye = Vec3{0, 9, 0};
  EXPECT_EQ(Camera::Place(options, mesh).status().message(),
            "--up is parallel to the direction from --eye to --target");
  options.up = {0, 0, 0};
  EXPECT_EQ(Camera::Place(options, mesh).status().message(), "--up has length 0");
}

}  // namespace
}  // namespace deltaray
