#include "server/tree/wide_tree.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>
#include <vector>

#include "absl/container/inlined_vector.h"
#include "server/geometry/box_test.h"
#include "server/tree/leaf_recorder.h"
#include "server/tree/ray_kernels.h"

namespace deltaray {
namespace {

// One lane of a node, in the mesh's frame.
struct Child {
  Vec3d min, max;
  ChildRef ref;

  bool IsUsed() const { return min.x <= max.x; }
  double HalfArea() const {
    const Vec3d d = max - min;
    return d.x * d.y + d.y * d.z + d.z * d.x;
  }
};

// Reads nodes and leaves of any width.
class Reader {
 public:
  explicit Reader(const WideArrays& arrays)
      : arrays_(arrays), width_(Width(arrays.target)), unscale_(std::ldexp(1.0, -arrays.scale_exponent)) {}

  int width() const { return width_; }

  Child GetChild(ChildRef node, int lane) const {
    const std::byte* const data = At(node);
    Child child;
    for (int axis = 0; axis < 3; ++axis) {
      child.min[axis] = unscale_ * Load<float>(data, 2 * axis * width_ + lane);
      child.max[axis] = unscale_ * Load<float>(data, (2 * axis + 1) * width_ + lane);
    }
    child.ref = ChildRef(Load<uint32_t>(data, 6 * width_ + lane));
    return child;
  }

  uint32_t Primitive(ChildRef leaf, uint32_t i) const {
    return Load<uint32_t>(At(leaf), kIdColumn * leaf.triangles() + i) & kPrimitiveMask;
  }

 private:
  template <typename T>
  static T Load(const std::byte* data, size_t index) {
    T value;
    std::memcpy(&value, data + index * sizeof(T), sizeof(T));
    return value;
  }
  const std::byte* At(ChildRef ref) const { return arrays_.block.data() + ref.offset() * UnitBytes(width_); }

  const WideArrays& arrays_;
  const int width_;
  const double unscale_;
};

const RayKernels& KernelsNow(SimdTarget target) {
  return LeafRecorder::current() == nullptr ? KernelsOf(target) : RecordingKernelsOf(target);
}

}  // namespace

WideTree::WideTree(TrianglesView triangles, WideArrays arrays) : TraversedTree(triangles), arrays_(std::move(arrays)) {}

void WideTree::ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const {
  if (arrays_.levels == 0) return TraversedTree::ClosestHits(rays, options, hits);
  std::vector<uint32_t> odd;
  StopPoll stop(options.stopped);
  KernelsNow(arrays_.target).closest_hits({arrays_, triangles(), stop}, rays, options, hits, &odd);
  for (const uint32_t i : odd) hits[i] = ClosestHit(rays[i], options, stop);
}

void WideTree::AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const {
  if (arrays_.levels == 0) return TraversedTree::AnyHits(rays, options, any);
  std::vector<uint32_t> odd;
  StopPoll stop(options.stopped);
  KernelsNow(arrays_.target).any_hits({arrays_, triangles(), stop}, rays, options, any, &odd);
  for (const uint32_t i : odd) any[i] = AnyHit(rays[i], options, stop);
}

void WideTree::Traverse(const Ray& ray, Collector& collector) const {
  if (arrays_.levels == 0) return;
  if (KernelsNow(arrays_.target).collect({arrays_, triangles(), collector.stop()}, ray, collector)) return;

  // The plain way, in double: slow, and right for every ray.
  struct Entry {
    ChildRef ref;
    double first;
  };
  const Reader reader(arrays_);
  const BoxTest box_test(ray);
  absl::InlinedVector<Entry, 64> stack{{ChildRef::Node(0), 0}};
  while (!stack.empty() && !collector.stop().Step()) {
    const Entry entry = stack.back();
    stack.pop_back();
    if (entry.first > collector.limit()) continue;
    if (entry.ref.IsLeaf()) {
      for (uint32_t i = 0; i < entry.ref.triangles(); ++i) collector.Visit(reader.Primitive(entry.ref, i));
      continue;
    }
    const size_t begin = stack.size();
    for (int lane = 0; lane < reader.width(); ++lane) {
      const Child child = reader.GetChild(entry.ref, lane);
      if (!child.IsUsed()) continue;
      const Interval t = box_test(child.min, child.max, collector.limit());
      if (!t.IsEmpty()) stack.push_back({child.ref, t.first});
    }
    std::sort(stack.begin() + begin, stack.end(), [](const Entry& a, const Entry& b) { return a.first > b.first; });
  }
}

TreeShape WideTree::Shape() const {
  TreeShape shape;
  if (arrays_.levels == 0) return shape;
  const Reader reader(arrays_);
  const size_t unit = UnitBytes(reader.width());
  struct Entry {
    ChildRef ref;
    uint32_t depth;
    double half_area;  // 0: not known yet, the root
  };
  std::vector<Entry> stack{{ChildRef::Node(0), 0, 0}};
  double root_half_area = 0;
  while (!stack.empty()) {
    const Entry entry = stack.back();
    stack.pop_back();
    shape.max_depth = std::max(shape.max_depth, entry.depth);
    ++shape.nodes;
    // Where the root has no area, every node counts as if rays that meet the root met it.
    const double reached = entry.depth > 0 && root_half_area > 0 ? entry.half_area / root_half_area : 1;
    if (entry.ref.IsLeaf()) {
      ++shape.leaves;
      shape.references += entry.ref.triangles();
      shape.sah_cost += reached;
      shape.reference_bytes += unit * LeafUnits(entry.ref.triangles(), reader.width());
      continue;
    }
    shape.node_bytes += NodeBytes(reader.width());
    shape.sah_cost += reached;
    std::vector<Child> children;
    for (int lane = 0; lane < reader.width(); ++lane) {
      if (const Child child = reader.GetChild(entry.ref, lane); child.IsUsed()) children.push_back(child);
    }
    if (entry.depth == 0) {
      Child root = children[0];
      for (const Child& child : children) {
        for (int axis = 0; axis < 3; ++axis) {
          root.min[axis] = std::min(root.min[axis], child.min[axis]);
          root.max[axis] = std::max(root.max[axis], child.max[axis]);
        }
      }
      root_half_area = root.HalfArea();
    }
    for (const Child& child : children) stack.push_back({child.ref, entry.depth + 1, child.HalfArea()});
  }
  return shape;
}

}  // namespace deltaray
