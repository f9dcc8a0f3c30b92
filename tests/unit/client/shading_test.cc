#include "client/shading.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

namespace deltaray {
namespace {

using ::testing::ElementsAre;

constexpr float kMissT = std::numeric_limits<float>::infinity();

template <typename T>
std::string Bytes(std::initializer_list<T> values) {
  return std::string(reinterpret_cast<const char*>(values.begin()), values.size() * sizeof(T));
}

// Looks along -z.
Camera TestCamera(uint32_t width, uint32_t height) {
  CameraOptions options;
  options.eye = Vec3{0, 0, 5};
  options.target = Vec3{0, 0, 0};
  options.width = width;
  options.height = height;
  return *Camera::Place(options, v1::Mesh());
}

std::vector<uint8_t> Pixel(const Image& image, size_t i) {
  return {image.rgb[3 * i], image.rgb[3 * i + 1], image.rgb[3 * i + 2]};
}

constexpr uint32_t kNone = 0xFFFFFFFF;
const std::vector<uint8_t> kBackground = {24, 28, 38};

TEST(ShadingTest, NormalsGiveColours) {
  Shading shading(Shade::kNormal, TestCamera(3, 1), 3, 1);
  EXPECT_THAT(shading.columns(), ElementsAre(v1::HIT_COLUMN_NORMAL));
  v1::HitBatch hits;
  hits.set_ray_count(3);
  hits.set_normal(Bytes<float>({1, 0, 0, 0, 0, 0, 0, 0, -1}));
  ASSERT_TRUE(shading.Add(hits).ok());
  EXPECT_EQ(shading.hit_count(), 2u);
  const Image image = shading.Finish();
  EXPECT_EQ(Pixel(image, 0), (std::vector<uint8_t>{255, 128, 128}));
  EXPECT_EQ(Pixel(image, 1), kBackground);
  EXPECT_EQ(Pixel(image, 2), (std::vector<uint8_t>{128, 128, 0}));
}

TEST(ShadingTest, DepthsRunFromLightToDarkOverBatches) {
  Shading shading(Shade::kDepth, TestCamera(2, 2), 2, 2);
  EXPECT_THAT(shading.columns(), ElementsAre(v1::HIT_COLUMN_T, v1::HIT_COLUMN_PRIMITIVE_ID));
  v1::HitBatch hits;
  hits.set_ray_count(2);
  hits.set_t(Bytes<float>({7, kMissT}));
  hits.set_primitive_id(Bytes<uint32_t>({0, kNone}));
  ASSERT_TRUE(shading.Add(hits).ok());
  hits.set_t(Bytes<float>({3, 5}));
  hits.set_primitive_id(Bytes<uint32_t>({1, 2}));
  ASSERT_TRUE(shading.Add(hits).ok());
  EXPECT_EQ(shading.hit_count(), 3u);
  const Image image = shading.Finish();
  EXPECT_EQ(Pixel(image, 0)[0], 60);
  EXPECT_EQ(Pixel(image, 1), kBackground);
  EXPECT_EQ(Pixel(image, 2)[0], 240);
  EXPECT_EQ(Pixel(image, 3)[0], 150);
}

// The server rounds their t to infinity, as which a miss has it too.
TEST(ShadingTest, HitsBeyondFloatAreTheFarthest) {
  Shading shading(Shade::kDepth, TestCamera(3, 1), 3, 1);
  v1::HitBatch hits;
  hits.set_ray_count(3);
  hits.set_t(Bytes<float>({-std::numeric_limits<float>::max(), kMissT, kMissT}));
  hits.set_primitive_id(Bytes<uint32_t>({0, 1, kNone}));
  ASSERT_TRUE(shading.Add(hits).ok());
  EXPECT_EQ(shading.hit_count(), 2u);
  const Image image = shading.Finish();
  EXPECT_EQ(Pixel(image, 0)[0], 240);
  EXPECT_EQ(Pixel(image, 1)[0], 60);
  EXPECT_EQ(Pixel(image, 2), kBackground);
}

TEST(ShadingTest, LambertLightsBothSidesAlike) {
  Shading shading(Shade::kLambert, TestCamera(3, 1), 3, 1);
  v1::HitBatch hits;
  hits.set_ray_count(3);
  // Towards the viewer, away from it, and across.
  hits.set_normal(Bytes<float>({0, 0, 1, 0, 0, -1, 0.8f, 0, 0.6f}));
  ASSERT_TRUE(shading.Add(hits).ok());
  const Image image = shading.Finish();
  EXPECT_EQ(Pixel(image, 0), Pixel(image, 1));
  EXPECT_GT(Pixel(image, 0)[0], 150);
  EXPECT_LT(Pixel(image, 2)[0], Pixel(image, 0)[0]);
}

TEST(ShadingTest, PictureWithoutHitsIsBackground) {
  Shading shading(Shade::kDepth, TestCamera(1, 1), 1, 1);
  v1::HitBatch hits;
  hits.set_ray_count(1);
  hits.set_t(Bytes<float>({kMissT}));
  hits.set_primitive_id(Bytes<uint32_t>({kNone}));
  ASSERT_TRUE(shading.Add(hits).ok());
  EXPECT_EQ(shading.hit_count(), 0u);
  EXPECT_EQ(Pixel(shading.Finish(), 0), kBackground);
}

TEST(ShadingTest, RefusesColumnsOfWrongLengthAndTooManyRays) {
  Shading shading(Shade::kNormal, TestCamera(1, 1), 1, 1);
  v1::HitBatch hits;
  hits.set_ray_count(1);
  hits.set_normal(Bytes<float>({1, 0}));
  EXPECT_FALSE(shading.Add(hits).ok());
  Shading depth(Shade::kDepth, TestCamera(1, 1), 1, 1);
  hits.set_t(Bytes<float>({1}));
  EXPECT_FALSE(depth.Add(hits).ok());
  Shading small(Shade::kDepth, TestCamera(1, 1), 1, 1);
  hits.set_ray_count(2);
  hits.set_t(Bytes<float>({1, 0}));
  EXPECT_EQ(small.Add(hits).message(), "the server answered too many rays");
}

}  // namespace
}  // namespace deltaray
