#include "server/service/ray_batch.h"

#include <bit>
#include <cmath>
#include <limits>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/meshes.h"

namespace deltaray {
namespace {

using testing::HasSubstr;
constexpr float kInf = std::numeric_limits<float>::infinity();

BatchQuery Query(v1::RayLayout layout) {
  v1::RayQuery query;
  query.set_layout(layout);
  query.set_t_min(0.5f);
  query.set_t_max(7);
  return *ReadQuery(query);
}

// A mesh of 20 triangles, as far as rays are concerned.
TriangleMesh MeshAt(Vec3d origin) {
  TriangleMesh mesh;
  mesh.indices.resize(20);
  mesh.origin = origin;
  return mesh;
}

// The rays of `bytes`, read at an odd address.
absl::StatusOr<std::vector<Ray>> Decode(v1::RayLayout layout, const std::string& bytes, Vec3d origin = {},
                                        const std::string& excluded = "") {
  v1::RayBatch batch;
  batch.set_rays(bytes);
  batch.set_excluded_primitive_ids(excluded);
  const RayBatchBytes copy = CopyRayBatch(batch);
  absl::StatusOr<RayBatchView> view = RayBatchView::Make(copy, Query(layout), MeshAt(origin), 1000);
  if (!view.ok()) return view.status();
  std::vector<Ray> rays(view->size());
  if (absl::Status status = view->Decode(0, rays); !status.ok()) return status;
  return rays;
}

std::string ErrorOf(v1::RayLayout layout, const std::string& bytes, Vec3d origin = {}) {
  const auto rays = Decode(layout, bytes, origin);
  EXPECT_EQ(rays.status().code(), absl::StatusCode::kInvalidArgument);
  return std::string(rays.status().message());
}

TEST(RayBatchTest, ReadsFloat32AndTakesTheIntervalFromTheQuery) {
  const auto rays = Decode(v1::RAY_LAYOUT_FLOAT32X6, Bytes<float>({1, 2, 3, 4, 5, 6, -1, -2, -3, -4, -5, -6}));
  ASSERT_TRUE(rays.ok()) << rays.status();
  ASSERT_EQ(rays->size(), 2u);
  EXPECT_EQ((*rays)[1].origin, (Vec3f{-1, -2, -3}));
  EXPECT_EQ((*rays)[1].direction, (Vec3f{-4, -5, -6}));
  EXPECT_EQ((*rays)[1].t_min, 0.5f);
  EXPECT_EQ((*rays)[1].t_max, 7.0f);
  EXPECT_EQ((*rays)[1].excluded_primitive, kNoPrimitive);
}

TEST(RayBatchTest, ReadsTheIntervalOfEachRay) {
  const auto rays = Decode(v1::RAY_LAYOUT_FLOAT32X8, Bytes<float>({1, 2, 3, 4, 5, 6, -kInf, kInf}));
  ASSERT_TRUE(rays.ok()) << rays.status();
  EXPECT_EQ((*rays)[0].t_min, -kInf);
  EXPECT_EQ((*rays)[0].t_max, kInf);
  const auto doubles = Decode(v1::RAY_LAYOUT_FLOAT64X8, Bytes<double>({1, 2, 3, 4, 5, 6, 0.1, 1e300}));
  ASSERT_TRUE(doubles.ok()) << doubles.status();
  EXPECT_EQ((*doubles)[0].t_min, 0.1f);
  EXPECT_EQ((*doubles)[0].t_max, kInf);
}

TEST(RayBatchTest, ReadsExcludedPrimitives) {
  const auto rays = Decode(v1::RAY_LAYOUT_FLOAT32X6, Bytes<float>({1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5, 6}), {},
                           Bytes<uint32_t>({17, kNoPrimitive}));
  ASSERT_TRUE(rays.ok()) << rays.status();
  EXPECT_EQ((*rays)[0].excluded_primitive, 17u);
  EXPECT_EQ((*rays)[1].excluded_primitive, kNoPrimitive);
}

TEST(RayBatchTest, WithoutMeshOriginFloat32KeepsItsBits) {
  const std::vector<float> numbers = {-0.0f, 1e-45f, 3.4e38f, 1e-40f, -0.0f, 0.1f};
  const auto rays = Decode(v1::RAY_LAYOUT_FLOAT32X6, Bytes(numbers));
  ASSERT_TRUE(rays.ok()) << rays.status();
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(std::bit_cast<uint32_t>((*rays)[0].origin[i]), std::bit_cast<uint32_t>(numbers[i]));
    EXPECT_EQ(std::bit_cast<uint32_t>((*rays)[0].direction[i]), std::bit_cast<uint32_t>(numbers[i + 3]));
  }
}

TEST(RayBatchTest, SubtractsTheMeshOriginInDoubleAndRoundsOnce) {
  // 4,500,000.1 as float32 is off by 0.1; rounded after the subtraction it is not.
  const Vec3d origin{4.5e6, -1e9, 0};
  const auto rays = Decode(v1::RAY_LAYOUT_FLOAT64X6, Bytes<double>({4'500'000.1, -1e9 + 0.25, 3, 1, 0, 0}), origin);
  ASSERT_TRUE(rays.ok()) << rays.status();
  EXPECT_EQ((*rays)[0].origin, (Vec3f{static_cast<float>(4'500'000.1 - 4.5e6), 0.25f, 3}));
  EXPECT_EQ((*rays)[0].direction, (Vec3f{1, 0, 0}));
  const auto floats = Decode(v1::RAY_LAYOUT_FLOAT32X6, Bytes<float>({4'500'001.5f, 0, 3, 1, 0, 0}), origin);
  ASSERT_TRUE(floats.ok()) << floats.status();
  EXPECT_EQ((*floats)[0].origin, (Vec3f{1.5f, 1e9f, 3}));
}

TEST(RayBatchTest, NumbersThatAreNotFiniteAreRefusedByRayAndComponent) {
  std::vector<float> good(3 * 6, 1);
  for (int component = 0; component < 6; ++component) {
    static constexpr const char* kNames[] = {"origin.x",    "origin.y",    "origin.z",
                                             "direction.x", "direction.y", "direction.z"};
    for (float value : {NAN, kInf, -kInf}) {
      std::vector<float> bad = good;
      bad[2 * 6 + component] = value;
      EXPECT_EQ(ErrorOf(v1::RAY_LAYOUT_FLOAT32X6, Bytes(bad)), std::string("rays.rays: ray 2: ") + kNames[component] +
                                                                   (std::isnan(value) ? " is NaN" : " is infinite"));
    }
  }
  EXPECT_EQ(ErrorOf(v1::RAY_LAYOUT_FLOAT32X8, Bytes<float>({1, 2, 3, 4, 5, 6, NAN, 1})),
            "rays.rays: ray 0: t_min is NaN");
  EXPECT_EQ(ErrorOf(v1::RAY_LAYOUT_FLOAT64X8, Bytes<double>({1, 2, 3, 4, 5, 6, 0, NAN})),
            "rays.rays: ray 0: t_max is NaN");
}

TEST(RayBatchTest, NumbersOutOfTheRangeOfFloat32AreRefused) {
  EXPECT_THAT(ErrorOf(v1::RAY_LAYOUT_FLOAT64X6, Bytes<double>({0, 1e39, 0, 1, 0, 0})),
              HasSubstr("ray 0: origin.y is out of the range of float32"));
  EXPECT_THAT(ErrorOf(v1::RAY_LAYOUT_FLOAT32X6, Bytes<float>({3e38f, 0, 0, 1, 0, 0}), {-3e38, 0, 0}),
              HasSubstr("ray 0: origin.x is out of the range of float32"));
  EXPECT_THAT(ErrorOf(v1::RAY_LAYOUT_FLOAT64X6, Bytes<double>({0, 0, 0, 1, 0, -1e39})),
              HasSubstr("ray 0: direction.z is out of the range of float32"));
  EXPECT_THAT(ErrorOf(v1::RAY_LAYOUT_FLOAT64X6, Bytes<double>({0, 0, 0, 1e-60, 0, -1e-50})),
              HasSubstr("ray 0: direction is too short for float32"));
  // Directions of length zero are allowed, and hit nothing.
  EXPECT_TRUE(Decode(v1::RAY_LAYOUT_FLOAT64X6, Bytes<double>({0, 0, 0, 0, -0.0, 0})).ok());
}

TEST(RayBatchTest, ArraysOfTheWrongLengthAreRefused) {
  EXPECT_EQ(ErrorOf(v1::RAY_LAYOUT_FLOAT32X6, std::string(25, 'x')),
            "rays.rays: 25 bytes are not a multiple of 24, the bytes of a ray in RAY_LAYOUT_FLOAT32X6");
  EXPECT_THAT(ErrorOf(v1::RAY_LAYOUT_FLOAT64X8, std::string(96, 'x')), HasSubstr("96 bytes are not a multiple of 64"));
  v1::RayBatch batch;
  batch.set_rays(std::string(48, 0));
  batch.set_excluded_primitive_ids(std::string(4, 0));
  const auto view = RayBatchView::Make(CopyRayBatch(batch), Query(v1::RAY_LAYOUT_FLOAT32X6), MeshAt({}), 1000);
  EXPECT_EQ(view.status(), absl::InvalidArgumentError("rays.excluded_primitive_ids: 4 bytes, not 8 for 2 rays"));
}

TEST(RayBatchTest, ExcludedPrimitivesThatTheMeshHasNotAreRefused) {
  const std::string rays(2 * 24, '\0');
  EXPECT_TRUE(Decode(v1::RAY_LAYOUT_FLOAT32X6, rays, {}, Bytes<uint32_t>({kNoPrimitive, 19})).ok());
  for (const uint32_t id : {20u, kNoPrimitive - 1}) {
    EXPECT_EQ(Decode(v1::RAY_LAYOUT_FLOAT32X6, rays, {}, Bytes<uint32_t>({0, id})).status(),
              absl::InvalidArgumentError(absl::StrCat("rays.excluded_primitive_ids: ray 1: ", id,
                                                      " is no triangle of the mesh, which has 20; 4294967295 stands "
                                                      "for none")));
  }
}

TEST(RayBatchTest, MoreRaysThanTheLimitAreRefused) {
  v1::RayBatch batch;
  batch.set_rays(std::string(24 * 1000, 0));
  EXPECT_TRUE(RayBatchView::Make(CopyRayBatch(batch), Query(v1::RAY_LAYOUT_FLOAT32X6), MeshAt({}), 1000).ok());
  batch.set_rays(std::string(24 * 1001, 0));
  EXPECT_EQ(
      RayBatchView::Make(CopyRayBatch(batch), Query(v1::RAY_LAYOUT_FLOAT32X6), MeshAt({}), 1000).status(),
      absl::ResourceExhaustedError("rays.rays: 1001 rays are over the limit of 1000 rays a batch (--max-batch-rays)"));
}

TEST(RayBatchTest, AnEmptyBatchIsValid) {
  const auto rays = Decode(v1::RAY_LAYOUT_FLOAT64X6, "");
  ASSERT_TRUE(rays.ok()) << rays.status();
  EXPECT_TRUE(rays->empty());
}

}  // namespace
}  // namespace deltaray
