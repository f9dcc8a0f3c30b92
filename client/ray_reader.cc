#include "client/ray_reader.h"

#include <utility>

namespace deltaray {

absl::StatusOr<std::unique_ptr<RayReader>> OpenRays(const std::string& path, std::optional<v1::RayLayout> raw_layout,
                                                    const Session& session) {
  auto file = InputFile::Open(path, session);
  if (!file.ok()) return file.status();
  if (raw_layout) return OpenRawRays(*std::move(file), *raw_layout);
  return OpenCsvRays(*std::move(file));
}

}  // namespace deltaray
