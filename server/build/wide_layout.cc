#include "server/build/wide_layout.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <span>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/build/wide_plan.h"

namespace deltaray {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
// Nodes above this level spread their subtrees over tasks.
constexpr uint32_t kTaskLevels = 3;

// x * scale, rounded down or up where it is no float. In double, a float times a power of two of the frame is exact.
float ScaleDown(float x, double scale) {
  const double exact = scale * x;
  const float rounded = static_cast<float>(exact);
  return rounded > exact ? std::nextafter(rounded, -kInfinity) : rounded;
}
float ScaleUp(float x, double scale) { return -ScaleDown(-x, scale); }

// The exponent that brings all coordinates in `bounds` below 1 in magnitude, the greatest one to at least 1/2.
int ScaleExponent(const Bounds& bounds) {
  if (bounds.IsEmpty()) return 0;
  float greatest = 0;
  for (int axis = 0; axis < 3; ++axis) {
    greatest = std::max({greatest, std::abs(bounds.min[axis]), std::abs(bounds.max[axis])});
  }
  int exponent = 0;
  std::frexp(greatest, &exponent);
  return -exponent;
}

template <int kWidth>
class Layout {
 public:
  Layout(const BvhArrays& tree, const TrianglesView& triangles, BuildContext& context,
         std::vector<LeafReferences>* leaf_references)
      : tree_(tree),
        triangles_(triangles),
        context_(context),
        leaf_references_(leaf_references),
        plan_(tree.nodes, kWidth, context) {}

  absl::StatusOr<WideArrays> Make(SimdTarget target) {
    if (context_.cancelled()) return absl::CancelledError("the build was cancelled");
    WideArrays arrays;
    arrays.target = target;
    // Of the corners of triangles that can be hit: what no such triangle uses may lie anywhere.
    arrays.scale_exponent = ScaleExponent(tree_.nodes[0].bounds);
    scale_ = std::ldexp(1.0, arrays.scale_exponent);

    // 1. Find how much room each subtree takes.
    sizes_ = LargeArray<uint32_t>(tree_.nodes.size());
    const Size whole = tree_.nodes[0].IsLeaf() || plan_.LeafSize(0) != 0 ? SingleLeafSize() : Measure(0, 0);
    if (context_.cancelled()) return absl::CancelledError("the build was cancelled");
    if (whole.units > ChildRef::kMaxOffset) {
      return absl::ResourceExhaustedError(absl::StrCat("the wide tree takes ", whole.units * UnitBytes(kWidth),
                                                       " bytes, over the limit of ",
                                                       ChildRef::kMaxOffset * UnitBytes(kWidth)));
    }

    // 2. Write it.
    arrays.levels = whole.levels;
    arrays.block = LargeArray<std::byte>(whole.units * UnitBytes(kWidth) + kLeafSlack);
    block_ = arrays.block.data();
    if (leaf_references_ != nullptr) leaf_references_->assign(whole.units, {});
    std::memset(block_ + whole.units * UnitBytes(kWidth), 0, kLeafSlack);
    if (tree_.nodes[0].IsLeaf() || plan_.LeafSize(0) != 0) {
      const uint32_t root = 0;
      WriteNode(std::span(&root, 1), 0, 0);
    } else {
      Write(0, 0, 0);
    }
    if (context_.cancelled()) return absl::CancelledError("the build was cancelled");
    arrays.exact_corners = exact_corners_;
    return arrays;
  }

 private:
  struct Size {
    uint64_t units = 0;
    uint32_t levels = 0;
  };
  using ChildArray = std::array<uint32_t, kWidth>;

  static constexpr uint64_t kNodeUnits = NodeBytes(kWidth) / UnitBytes(kWidth);

  // A tree that is one leaf has a node above it all the same.
  Size SingleLeafSize() const { return {kNodeUnits + LeafUnits(Gather(0).size(), kWidth), 1}; }

  std::span<const uint32_t> Children(uint32_t node, ChildArray& children) const {
    return std::span(children).first(plan_.Children(node, children.data()));
  }

  // Sums up the subtree of a node of the wide tree, and notes each such subtree's size.
  Size Measure(uint32_t node, uint32_t level) {
    if (context_.cancelled()) return {};
    ChildArray array;
    const std::span<const uint32_t> children = Children(node, array);
    std::array<Size, kWidth> sizes;
    const auto measure = [&](size_t i) {
      if (const uint32_t count = plan_.LeafSize(children[i])) {
        sizes[i] = {LeafUnits(static_cast<uint32_t>(Gather(children[i]).size()), kWidth), 0};
      } else {
        sizes[i] = Measure(children[i], level + 1);
      }
    };
    ForEach(children.size(), level, measure);
    Size sum{kNodeUnits, 0};
    for (size_t i = 0; i < children.size(); ++i) {
      sum.units += sizes[i].units;
      sum.levels = std::max(sum.levels, sizes[i].levels);
    }
    ++sum.levels;
    // Larger ones are refused before this is read.
    sizes_[node] = static_cast<uint32_t>(std::min<uint64_t>(sum.units, ChildRef::kMaxOffset));
    return sum;
  }

  void Write(uint32_t node, uint64_t offset, uint32_t level) {
    if (context_.cancelled()) return;
    ChildArray array;
    WriteNode(Children(node, array), offset, level);
  }

  // Writes the node with these children, its leaves, and the subtrees of the others.
  void WriteNode(std::span<const uint32_t> children, uint64_t offset, uint32_t level) {
    std::array<uint64_t, kWidth> offsets;
    std::array<LeafTriangles, kWidth> leaves;
    uint64_t next = offset + kNodeUnits;
    for (size_t i = 0; i < children.size(); ++i) {
      if (plan_.LeafSize(children[i]) == 0) continue;
      leaves[i] = Gather(children[i]);
      offsets[i] = next;
      next += LeafUnits(static_cast<uint32_t>(leaves[i].size()), kWidth);
    }
    for (size_t i = 0; i < children.size(); ++i) {
      if (plan_.LeafSize(children[i]) != 0) continue;
      offsets[i] = next;
      next += sizes_[children[i]];
    }

    // Indices and corners lie anywhere: all of them are asked for before any is waited for.
    for (size_t i = 0; i < children.size(); ++i) {
      for (const uint32_t id : leaves[i].ids()) __builtin_prefetch(&triangles_.indices[id]);
    }
    for (size_t i = 0; i < children.size(); ++i) {
      for (const uint32_t id : leaves[i].ids()) {
        for (const uint32_t corner : triangles_.indices[id]) __builtin_prefetch(&triangles_.positions[corner]);
      }
    }

    WideNode<kWidth> node;
    for (int lane = 0; lane < kWidth; ++lane) {
      const bool used = lane < static_cast<int>(children.size());
      for (int axis = 0; axis < 3; ++axis) {
        const Bounds& bounds = used ? tree_.nodes[children[lane]].bounds : Bounds();
        node.bounds[2 * axis][lane] = used ? ScaleDown(bounds.min[axis], scale_) : kInfinity;
        node.bounds[2 * axis + 1][lane] = used ? ScaleUp(bounds.max[axis], scale_) : -kInfinity;
      }
      node.child[lane] = 0;
      if (!used) continue;
      const auto at = static_cast<uint32_t>(offsets[lane]);
      const auto size = static_cast<uint32_t>(leaves[lane].size());
      node.child[lane] = (size != 0 ? ChildRef::Leaf(at, size) : ChildRef::Node(at)).bits();
      if (size == 0) continue;
      WriteLeaf(leaves[lane], At(at));
      if (leaf_references_ != nullptr)
        (*leaf_references_)[at] = {FirstReference(children[lane]), plan_.LeafSize(children[lane])};
    }
    std::memcpy(At(offset), &node, sizeof(node));

    ForEach(children.size(), level, [&](size_t i) {
      if (leaves[i].size() == 0) Write(children[i], offsets[i], level + 1);
    });
  }

  // The triangles of a leaf, each once.
  class LeafTriangles {
   public:
    size_t size() const { return size_; }
    // In order of ids; does nothing where it is there already.
    void Insert(uint32_t primitive) {
      size_t at = size_;
      while (at > 0 && ids_[at - 1] > primitive) --at;
      if (at > 0 && ids_[at - 1] == primitive) return;
      std::copy_backward(ids_.begin() + at, ids_.begin() + size_, ids_.begin() + size_ + 1);
      ids_[at] = primitive;
      ++size_;
    }
    std::span<const uint32_t> ids() const { return std::span(ids_).first(size_); }

   private:
    std::array<uint32_t, kMaxLeafTriangles> ids_;
    size_t size_ = 0;
  };

  // Where the references of the subtree begin.
  uint32_t FirstReference(uint32_t node) const {
    while (!tree_.nodes[node].IsLeaf()) ++node;
    return tree_.nodes[node].offset;
  }

  LeafTriangles Gather(uint32_t node) const {
    LeafTriangles triangles;
    for (const uint32_t primitive : std::span(tree_.references).subspan(FirstReference(node), plan_.LeafSize(node))) {
      triangles.Insert(primitive);
    }
    return triangles;
  }

  void WriteLeaf(const LeafTriangles& leaf, std::byte* at) {
    const size_t count = leaf.size();
    std::array<float, (kLeafColumns - 1) * kMaxLeafTriangles> columns;
    std::array<uint32_t, kMaxLeafTriangles> ids;
    bool exact = true;
    for (size_t i = 0; i < count; ++i) {
      const Triangle triangle = triangles_[leaf.ids()[i]];
      const Vec3f* const corners[3] = {&triangle.v0, &triangle.v1, &triangle.v2};
      for (int corner = 0; corner < 3; ++corner) {
        for (int axis = 0; axis < 3; ++axis) {
          const double scaled = scale_ * (*corners[corner])[axis];
          float& stored = columns[(3 * corner + axis) * count + i];
          stored = static_cast<float>(scaled);
          exact &= stored == scaled;
        }
      }
      ids[i] = leaf.ids()[i] | SizeClass(triangle.GetBounds()) << kPrimitiveBits;
    }
    const size_t column_bytes = count * sizeof(float),
                 bytes = LeafUnits(static_cast<uint32_t>(count), kWidth) * UnitBytes(kWidth);
    std::memcpy(at, columns.data(), kIdColumn * column_bytes);
    std::memcpy(at + kIdColumn * column_bytes, ids.data(), column_bytes);
    std::memset(at + kLeafColumns * column_bytes, 0, bytes - kLeafColumns * column_bytes);
    if (!exact) exact_corners_.store(false, std::memory_order_relaxed);
  }

  // See kMaxSizeClass.
  uint32_t SizeClass(const Bounds& bounds) const {
    double longest = 0;
    for (int axis = 0; axis < 3; ++axis) {
      longest = std::max(longest, static_cast<double>(bounds.max[axis]) - static_cast<double>(bounds.min[axis]));
    }
    longest *= scale_;
    if (longest == 0) return kMaxSizeClass;
    // The least power of two that is not below it.
    int exponent = 0;
    if (std::frexp(longest, &exponent) == 0.5) --exponent;
    return static_cast<uint32_t>(std::clamp(1 - exponent, 0, kMaxSizeClass));
  }

  // Calls body(i) for i < count, as tasks of their own where the level is high up.
  template <typename Body>
  void ForEach(size_t count, uint32_t level, const Body& body) {
    if (level >= kTaskLevels) {
      for (size_t i = 0; i < count; ++i) body(i);
      return;
    }
    tbb::parallel_for(size_t{0}, count, [&](size_t i) {
      const BuildContext::CpuTime time(context_);
      body(i);
    });
  }

  std::byte* At(uint64_t offset) { return block_ + offset * UnitBytes(kWidth); }

  const BvhArrays& tree_;
  const TrianglesView triangles_;
  BuildContext& context_;
  std::vector<LeafReferences>* const leaf_references_;
  const WidePlan plan_;
  double scale_ = 1;
  LargeArray<uint32_t> sizes_;  // units, by the binary node that became the wide one; of others nothing is written
  std::byte* block_ = nullptr;
  std::atomic<bool> exact_corners_{true};
};

}  // namespace

absl::StatusOr<WideArrays> LayOutWide(const BvhArrays& tree, const TrianglesView& triangles, SimdTarget target,
                                      BuildContext& context, std::vector<LeafReferences>* leaf_references) {
  if (triangles.size() > kMaxWidePrimitives) {
    return absl::ResourceExhaustedError(
        absl::StrCat(triangles.size(), " triangles; a wide tree takes at most ", kMaxWidePrimitives));
  }
  if (tree.nodes.empty()) {
    WideArrays empty;
    empty.target = target;
    if (leaf_references != nullptr) leaf_references->clear();
    return empty;
  }
  switch (target) {
    case SimdTarget::kSse4:
      return Layout<Width(SimdTarget::kSse4)>(tree, triangles, context, leaf_references).Make(target);
    case SimdTarget::kAvx2:
      return Layout<Width(SimdTarget::kAvx2)>(tree, triangles, context, leaf_references).Make(target);
    case SimdTarget::kAvx512:
      return Layout<Width(SimdTarget::kAvx512)>(tree, triangles, context, leaf_references).Make(target);
  }
  return absl::InternalError("unknown SIMD target");
}

}  // namespace deltaray
