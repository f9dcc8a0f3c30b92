#include "client/png_image.h"

#include <gtest/gtest.h>
#include <png.h>

#include <random>

namespace deltaray {
namespace {

Image Decode(const std::string& bytes) {
  png_image png = {};
  png.version = PNG_IMAGE_VERSION;
  EXPECT_TRUE(png_image_begin_read_from_memory(&png, bytes.data(), bytes.size())) << png.message;
  EXPECT_EQ(png.format, static_cast<png_uint_32>(PNG_FORMAT_RGB));
  Image image{png.width, png.height, std::vector<uint8_t>(PNG_IMAGE_SIZE(png))};
  EXPECT_TRUE(png_image_finish_read(&png, nullptr, image.rgb.data(), 0, nullptr)) << png.message;
  return image;
}

TEST(PngImageTest, RoundTrips) {
  std::mt19937 random(1);
  const uint32_t sizes[][2] = {{1, 1}, {3, 2}, {640, 480}, {1, 1000}};
  for (const auto& [width, height] : sizes) {
    Image image{width, height, std::vector<uint8_t>(3 * size_t{width} * height)};
    for (uint8_t& channel : image.rgb) channel = random();
    const absl::StatusOr<std::string> png = EncodePng(image);
    ASSERT_TRUE(png.ok()) << png.status();
    const Image decoded = Decode(*png);
    EXPECT_EQ(decoded.width, width);
    EXPECT_EQ(decoded.height, height);
    EXPECT_EQ(decoded.rgb, image.rgb);
  }
}

}  // namespace
}  // namespace deltaray
