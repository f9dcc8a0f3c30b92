// The bytes of a wide tree: nodes of 4, 8 or 16 children, and leaves of up to 8 triangles.

#ifndef SERVER_TREE_WIDE_NODE_H_
#define SERVER_TREE_WIDE_NODE_H_

#include <cstddef>
#include <cstdint>

namespace deltaray {

// Most triangles of a leaf: as many as the kernels test at once.
inline constexpr uint32_t kMaxLeafTriangles = 8;

// Primitive ids take 27 bits of a leaf's id column.
inline constexpr int kPrimitiveBits = 27;
inline constexpr uint32_t kPrimitiveMask = (uint32_t{1} << kPrimitiveBits) - 1;
inline constexpr uint64_t kMaxWidePrimitives = uint64_t{1} << kPrimitiveBits;

// Where something stands in a tree's block, in units of a node's alignment, and what it is.
class ChildRef {
 public:
  ChildRef() = default;
  explicit ChildRef(uint32_t bits) : bits_(bits) {}
  static ChildRef Node(uint32_t offset) { return ChildRef(offset << kKindBits); }
  // REQUIRES: 1 <= triangles <= kMaxLeafTriangles.
  static ChildRef Leaf(uint32_t offset, uint32_t triangles) { return ChildRef(offset << kKindBits | triangles); }

  enum Kind : uint8_t { kNode, kLeaf, kNothing };
  // By a table: what it is can seldom be foretold.
  Kind kind() const { return kKinds[bits_ & kKindMask]; }
  bool IsLeaf() const { return kind() == kLeaf; }
  uint32_t triangles() const { return bits_ & kKindMask; }  // of a leaf; 0: a node
  uint32_t offset() const { return bits_ >> kKindBits; }
  uint32_t bits() const { return bits_; }

  static constexpr int kKindBits = 4;
  // The bits of a reference to nothing.
  static constexpr uint32_t kNone = (1u << kKindBits) - 1;
  static constexpr uint32_t kMaxOffset = (uint32_t{1} << (32 - kKindBits)) - 1;

 private:
  static constexpr uint32_t kKindMask = (1u << kKindBits) - 1;
  static constexpr Kind kKinds[kKindMask + 1] = {kNode,    kLeaf,    kLeaf,    kLeaf,    kLeaf,    kLeaf,
                                                 kLeaf,    kLeaf,    kLeaf,    kNothing, kNothing, kNothing,
                                                 kNothing, kNothing, kNothing, kNothing};

  uint32_t bits_ = 0;
};

// A node. Coordinates are those of the tree's own frame (WideArrays::scale_exponent). A lane without a child has the
// empty box [+inf, -inf], which no ray is in.
template <int kWidth>
struct alignas(4 * kWidth) WideNode {
  // bounds[2 * axis]: lower faces, bounds[2 * axis + 1]: upper faces.
  float bounds[6][kWidth];
  uint32_t child[kWidth];  // bits of ChildRef
};

// Bytes of the units that ChildRef counts in.
constexpr size_t UnitBytes(int width) { return sizeof(float) * width; }
constexpr size_t NodeBytes(int width) { return 7 * sizeof(float) * width; }

// A leaf of n triangles is ten columns of n entries of 4 bytes, without gaps: x, y, z of the first corners, of the
// second, of the third, then ids. It takes whole units, and may be read up to kLeafSlack bytes past its end: lanes past
// n hold anything.
//
// The low kPrimitiveBits of an id are the primitive's. The rest is the triangle's size class c: none of its edges is
// longer along any axis than 2^(1 - c).
inline constexpr int kLeafColumns = 10;
inline constexpr int kIdColumn = 9;
inline constexpr size_t kLeafSlack = 64;
inline constexpr int kMaxSizeClass = 31;

constexpr size_t LeafUnits(uint32_t triangles, int width) {
  return (kLeafColumns * sizeof(float) * triangles + UnitBytes(width) - 1) / UnitBytes(width);
}

}  // namespace deltaray

#endif  // SERVER_TREE_WIDE_NODE_H_
