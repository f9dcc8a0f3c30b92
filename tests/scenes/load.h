// Scenes by name.

#ifndef TESTS_SCENES_LOAD_H_
#define TESTS_SCENES_LOAD_H_

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/mesh/triangle_mesh.h"

namespace deltaray {

// The names that LoadScene knows: the scans "bunny", "dragon", "elephant" and "armadillo", the made "city", "soup" and
// "terrain" (1000 × 1000 squares), and every pathological scene at its full size.
std::vector<std::string> SceneNames();

// Reads or makes a scene. NOT_FOUND where its file is missing, saying how to get it; INVALID_ARGUMENT, listing the
// names, where there is none of that name.
absl::StatusOr<TriangleMesh> LoadScene(std::string_view name);

}  // namespace deltaray

#endif  // TESTS_SCENES_LOAD_H_
