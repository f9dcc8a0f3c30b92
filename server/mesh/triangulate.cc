#include "server/mesh/triangulate.h"

namespace deltaray {

bool Triangulator::Append(std::span<const uint32_t> corners, std::vector<std::array<uint32_t, 3>>* triangles) {
  for (size_t i = 2; i < corners.size(); ++i) triangles->push_back({corners[0], corners[i - 1], corners[i]});
  return true;
}

}  // namespace deltaray
