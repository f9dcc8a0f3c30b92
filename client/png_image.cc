#include "client/png_image.h"

#include <png.h>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"

namespace deltaray {

absl::StatusOr<std::string> EncodePng(const Image& image) {
  png_image png = {};
  png.version = PNG_IMAGE_VERSION;
  png.width = image.width;
  png.height = image.height;
  png.format = PNG_FORMAT_RGB;
  // One pass into a buffer that surely holds it, instead of one pass to learn the size and a second one.
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(png);
  std::string bytes(size, '\0');
  if (!png_image_write_to_memory(&png, bytes.data(), &size, /*convert_to_8_bit=*/0, image.rgb.data(),
                                 /*row_stride=*/0, /*colormap=*/nullptr)) {
    return LocalError(absl::StrCat("cannot encode PNG: ", png.message));
  }
  bytes.resize(size);
  return bytes;
}

}  // namespace deltaray
