// A quick tree over a δ-leaf that is not built yet.

#ifndef SERVER_BUILD_GROUP_REFERENCES_H_
#define SERVER_BUILD_GROUP_REFERENCES_H_

#include <cstdint>
#include <span>

#include "server/build/reference.h"
#include "server/tree/bvh.h"
#include "server/tree/wide_node.h"

namespace deltaray {

// Nodes of the tree that GroupReferences makes of so many references. REQUIRES: references > 0.
constexpr uint32_t GroupNodes(uint32_t references) {
  return 2 * ((references + kMaxLeafTriangles - 1) / kMaxLeafTriangles) - 1;
}

// Halves `references` at the median, along the axis in which their centres lie widest apart, down to leaves of
// kMaxLeafTriangles, all full but one: a tree of nearly no cost and not far behind a better one, since a δ-leaf is
// only a few leaves. Writes it to `arrays`, in depth-first order, from index `node` and index `reference` on; there
// must be room for GroupNodes(references.size()) nodes and for all references. Changes the order of `references`.
// REQUIRES: references is not empty.
void GroupReferences(std::span<Reference> references, uint32_t node, uint32_t reference, BvhArrays* arrays);

}  // namespace deltaray

#endif  // SERVER_BUILD_GROUP_REFERENCES_H_
