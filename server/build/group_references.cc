#include "server/build/group_references.h"

#include <algorithm>

#include "server/geometry/bounds.h"
#include "server/geometry/packed_bounds.h"

namespace deltaray {
namespace {

// The axis in which the centres lie widest apart.
int WidestAxisOfCentres(std::span<const Reference> references) {
  PackedBounds centres;
  for (const Reference& reference : references) centres.Extend(reference.packed_bounds().HalfCentre());
  return static_cast<Bounds>(centres).WidestAxis();
}

}  // namespace

void GroupReferences(std::span<Reference> references, uint32_t node, uint32_t reference, BvhArrays* arrays) {
  const auto count = static_cast<uint32_t>(references.size());
  if (count <= kMaxLeafTriangles) {
    PackedBounds bounds;
    for (uint32_t i = 0; i < count; ++i) {
      bounds.Extend(references[i].packed_bounds());
      arrays->references[reference + i] = references[i].primitive;
    }
    arrays->nodes[node] = {static_cast<Bounds>(bounds), reference, count};
    return;
  }
  const int axis = WidestAxisOfCentres(references);
  const auto half_centre = [axis](const Reference& r) {
    return 0.25f * r.bounds.min[axis] + 0.25f * r.bounds.max[axis];
  };
  const uint32_t groups = (count + kMaxLeafTriangles - 1) / kMaxLeafTriangles;
  const uint32_t middle = groups / 2 * kMaxLeafTriangles;
  std::nth_element(references.begin(), references.begin() + middle, references.end(),
                   [&](const Reference& a, const Reference& b) { return half_centre(a) < half_centre(b); });
  const uint32_t first = node + 1, second = first + GroupNodes(middle);
  GroupReferences(references.first(middle), first, reference, arrays);
  GroupReferences(references.subspan(middle), second, reference + middle, arrays);
  arrays->nodes[node] = {Union(arrays->nodes[first].bounds, arrays->nodes[second].bounds), second, 0};
}

}  // namespace deltaray
