// References: what builders sort. A triangle that a spatial split cuts has several, each with the box of its part.

#ifndef SERVER_BUILD_REFERENCE_H_
#define SERVER_BUILD_REFERENCE_H_

#include <cstddef>
#include <cstdint>
#include <span>

#include "absl/status/statusor.h"
#include "server/build/build_context.h"
#include "server/geometry/bounds.h"
#include "server/geometry/packed_bounds.h"
#include "server/geometry/triangles.h"
#include "server/tree/large_memory.h"

namespace deltaray {

// Two to a cache line, where an array of them begins at one.
struct Reference {
  Bounds bounds;  // holds the part of the triangle in the node's cell
  uint32_t primitive = 0;
  uint32_t padding = 0;

  PackedBounds packed_bounds() const { return PackedBounds::Load(this); }
};
static_assert(sizeof(Reference) == 32 && offsetof(Reference, bounds) == 0);

// References, and room for more. A vector would write every element once before use, which takes longer than a cancel
// may on a large mesh; here elements past those written are uninitialised.
class ReferenceArray {
 public:
  ReferenceArray() = default;
  // Throws std::bad_alloc.
  ReferenceArray(size_t capacity, BuildContext& context);
  ReferenceArray(ReferenceArray&& other) noexcept;
  ReferenceArray& operator=(ReferenceArray&& other) noexcept;
  ~ReferenceArray();

  size_t capacity() const { return data_.size(); }
  size_t size() const { return size_; }
  Reference* data() { return data_.data(); }
  std::span<Reference> span() { return {data_.data(), size_}; }
  std::span<const Reference> span() const { return {data_.data(), size_}; }

  // REQUIRES: size() < capacity().
  void Add(const Reference& reference) { data_[size_++] = reference; }
  // REQUIRES: size <= capacity().
  void set_size(size_t size) { size_ = size; }
  // Gives back the room past size().
  void ShrinkToFit();

 private:
  LargeArray<Reference> data_;
  size_t size_ = 0;
  BuildContext* context_ = nullptr;  // counts the bytes
};

// The references of all triangles that are not degenerate, in order of primitive id, with room for `duplication_budget`
// more per triangle (up to 2^31 - 1 in all). In parallel. CANCELLED where the build is.
absl::StatusOr<ReferenceArray> MakeReferences(const TrianglesView& triangles, double duplication_budget,
                                              BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_REFERENCE_H_
