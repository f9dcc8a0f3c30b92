// Pictures, and their PNG encoding.

#ifndef CLIENT_PNG_IMAGE_H_
#define CLIENT_PNG_IMAGE_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace deltaray {

// 8 bits a channel, sRGB, rows from the top.
struct Image {
  uint32_t width = 0;
  uint32_t height = 0;
  // 3 × width × height: red, green, blue of each pixel.
  std::vector<uint8_t> rgb;
};

// The image as the bytes of a PNG file. Width and height are at least 1.
absl::StatusOr<std::string> EncodePng(const Image& image);

}  // namespace deltaray

#endif  // CLIENT_PNG_IMAGE_H_
