// Takes the place of embree.cc where Embree was not found.

#include "absl/status/status.h"
#include "tests/bench/embree.h"

namespace deltaray {

absl::StatusOr<std::unique_ptr<EmbreeScene>> EmbreeScene::Build(const TriangleMesh&, const Options&) {
  return absl::UnimplementedError(EmbreeVersion());
}

bool HaveEmbree() { return false; }
std::string EmbreeVersion() { return "built without Embree: install libembree-dev and configure again"; }

}  // namespace deltaray
