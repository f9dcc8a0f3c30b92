// A wide tree as data: what the collapse makes and the kernels read.

#ifndef SERVER_TREE_WIDE_ARRAYS_H_
#define SERVER_TREE_WIDE_ARRAYS_H_

#include <cstdint>

#include "server/tree/large_memory.h"
#include "server/tree/simd_target.h"
#include "server/tree/wide_node.h"

namespace deltaray {

// The nodes and leaves of a tree in depth-first order: a node, its leaves, then its other children's subtrees. The
// bytes are a function of triangles, binary tree and target alone.
struct WideArrays {
  SimdTarget target = SimdTarget::kSse4;
  // Stored coordinates are the mesh's times 2^scale_exponent, all of magnitude below 1: the frame of the tree, in which
  // float neither overflows nor underflows where it matters.
  int scale_exponent = 0;
  // Whether every stored corner is the mesh's exactly. Else some are rounded to a multiple of 2^-149.
  bool exact_corners = true;
  // Nodes on the longest way down; 0: the tree is empty.
  uint32_t levels = 0;
  // The root is the node at offset 0. kLeafSlack bytes follow the last leaf.
  LargeArray<std::byte> block;
};

}  // namespace deltaray

#endif  // SERVER_TREE_WIDE_ARRAYS_H_
