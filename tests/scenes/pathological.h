// Meshes on which ray tracing structures are known to fail: builders that do not end, boxes that leak, planes that run
// through flat geometry, numbers at the ends of float's range.

#ifndef TESTS_SCENES_PATHOLOGICAL_H_
#define TESTS_SCENES_PATHOLOGICAL_H_

#include <cstdint>
#include <span>
#include <string_view>

#include "server/mesh/triangle_mesh.h"

namespace deltaray {

struct PathologicalScene {
  std::string_view name;  // as on the command line: lower case, words joined by '_'
  // Makes the scene with about `size` parts (a part is one to twelve triangles). The same size gives the same mesh.
  TriangleMesh (*make)(uint32_t size);
  // The size at which it is worst, for builders.
  uint32_t full_size;
  // A size at which every ray can be tried against every triangle.
  uint32_t small_size;
};

// All of them, in a fixed order.
std::span<const PathologicalScene> PathologicalScenes();

}  // namespace deltaray

#endif  // TESTS_SCENES_PATHOLOGICAL_H_
