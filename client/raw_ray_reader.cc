#include "absl/strings/str_cat.h"
#include "client/exit_code.h"
#include "client/ray_reader.h"

namespace deltaray {
namespace {

class RawRayReader : public RayReader {
 public:
  RawRayReader(InputFile file, v1::RayLayout layout) : file_(std::move(file)), layout_(layout) {}

  v1::RayLayout layout() const override { return layout_; }

  absl::StatusOr<size_t> Read(size_t limit, std::string* rays) override {
    const size_t begin = rays->size();
    const size_t ray_bytes = RayBytes(layout_);
    rays->resize(begin + limit * ray_bytes);
    const absl::StatusOr<size_t> bytes = file_.Read(std::span(*rays).subspan(begin));
    if (!bytes.ok()) return bytes.status();
    rays->resize(begin + *bytes);
    const size_t count = *bytes / ray_bytes;
    if (*bytes % ray_bytes != 0) {
      return LocalError(absl::StrCat(file_.name(), ": ends inside ray ", rays_read_ + count, ", after ",
                                     *bytes % ray_bytes, " of its ", ray_bytes, " bytes"));
    }
    rays_read_ += count;
    return count;
  }

 private:
  InputFile file_;
  const v1::RayLayout layout_;
  uint64_t rays_read_ = 0;
};

}  // namespace

size_t RayBytes(v1::RayLayout layout) {
  switch (layout) {
    case v1::RAY_LAYOUT_FLOAT32X8:
      return 8 * sizeof(float);
    case v1::RAY_LAYOUT_FLOAT64X6:
      return 6 * sizeof(double);
    case v1::RAY_LAYOUT_FLOAT64X8:
      return 8 * sizeof(double);
    default:
      return 6 * sizeof(float);
  }
}

std::unique_ptr<RayReader> OpenRawRays(InputFile file, v1::RayLayout layout) {
  return std::make_unique<RawRayReader>(std::move(file), layout);
}

}  // namespace deltaray
