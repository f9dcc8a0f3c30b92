// Rays and triangles as the leaf tests take them: one ray against several triangles, or several against one.

#if defined(SERVER_TREE_LEAF_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_LEAF_LANES_INL_H_
#undef SERVER_TREE_LEAF_LANES_INL_H_
#else
#define SERVER_TREE_LEAF_LANES_INL_H_
#endif

#include <cstddef>
#include <cstdint>

#include "hwy/highway.h"
#include "server/tree/node_test-inl.h"
#include "server/tree/ray_slot.h"
#include "server/tree/wide_node.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// Triangles that are tested at once against one ray: a whole leaf, or half of one where registers have only 4 lanes.
using DLeaf = hn::CappedTag<float, kMaxLeafTriangles>;
constexpr uint32_t kLeafLanes = hn::MaxLanes(DLeaf());
constexpr size_t kLeafParts = kMaxLeafTriangles / kLeafLanes;

// A leaf in memory.
struct LeafView {
  const float* columns;
  uint32_t count;

  const float* Corner(int corner, uint32_t axis) const { return columns + (3 * corner + axis) * count; }
  const uint32_t* ids() const { return reinterpret_cast<const uint32_t*>(columns + kIdColumn * count); }
  uint32_t Primitive(uint32_t lane) const { return ids()[lane] & kPrimitiveMask; }
};

// Of triangles with these ids: no edge is longer than this along any axis.
template <class D>
HWY_ATTR HWY_INLINE hn::Vec<D> SizesOf(D, hn::Vec<hn::RebindToUnsigned<D>> ids) {
  const hn::RebindToUnsigned<D> du;
  return hn::BitCast(D(), hn::ShiftLeft<23>(hn::Sub(hn::Set(du, 128), hn::ShiftRight<kPrimitiveBits>(ids))));
}

// Triangles of a leaf, from `first` on, one a lane.
struct LeafLanes {
  using D = DLeaf;
  LeafView leaf;
  uint32_t first;

  HWY_ATTR hn::Vec<D> Corner(int corner, uint32_t axis) const {
    return hn::LoadU(D(), leaf.Corner(corner, axis) + first);
  }
  HWY_ATTR hn::Vec<hn::RebindToUnsigned<D>> Ids() const {
    return hn::LoadU(hn::RebindToUnsigned<D>(), leaf.ids() + first);
  }
  HWY_ATTR hn::Mask<D> Valid() const { return hn::FirstN(D(), leaf.count - first); }
};

// One ray, in all lanes.
struct OneRay {
  using D = DLeaf;
  const RaySlot& ray;

  HWY_ATTR hn::Vec<D> Origin(uint32_t axis) const { return hn::Set(D(), ray.origin[axis]); }
  HWY_ATTR hn::Vec<D> Direction(uint32_t axis) const { return hn::Set(D(), ray.direction[axis]); }
  HWY_ATTR hn::Vec<D> TMin() const { return hn::Set(D(), ray.t_min); }
  HWY_ATTR hn::Vec<D> Limit() const { return hn::Set(D(), ray.limit); }
  uint32_t Axis(int i) const { return ray.axis[i]; }
  HWY_ATTR hn::Vec<D> Shear(int i) const { return hn::Set(D(), ray.shear[i]); }
  HWY_ATTR hn::Vec<D> EdgeSlack() const { return hn::Set(D(), ray.edge_slack); }
  HWY_ATTR hn::Vec<D> DetSlack() const { return hn::Set(D(), ray.det_slack); }
  HWY_ATTR hn::Vec<D> EndSlack() const { return hn::Set(D(), ray.end_slack); }
  HWY_ATTR hn::Vec<hn::RebindToUnsigned<D>> Excluded() const {
    return hn::Set(hn::RebindToUnsigned<D>(), ray.excluded);
  }
};

// Rays of a packet.
constexpr size_t kPacketRays = 16;

// Those rays in the tree's frame, in columns; RaySlot says what they mean.
struct RayColumns {
  HWY_ALIGN float inverse[3][kPacketRays];
  HWY_ALIGN float near_offset[3][kPacketRays];
  HWY_ALIGN float far_offset[3][kPacketRays];
  HWY_ALIGN float origin[3][kPacketRays];
  HWY_ALIGN float direction[3][kPacketRays];
  HWY_ALIGN float t_min[kPacketRays];
  HWY_ALIGN float limit[kPacketRays];
  HWY_ALIGN uint32_t excluded[kPacketRays];
  // At kExact.
  HWY_ALIGN float edge_slack[kPacketRays];
  HWY_ALIGN float det_slack[kPacketRays];
  HWY_ALIGN float end_slack[kPacketRays];
  HWY_ALIGN uint32_t exact[kPacketRays];
  // At kWatertight. Rays whose axes are not in the same order cannot be tested together.
  HWY_ALIGN uint32_t axis[3][kPacketRays];
  HWY_ALIGN float shear[3][kPacketRays];
  bool same_axes = true;
  // The answers so far, at kFast and kWatertight: those of Hit, but for t's scale.
  HWY_ALIGN float t[kPacketRays];
  HWY_ALIGN float u[kPacketRays];
  HWY_ALIGN float v[kPacketRays];
  HWY_ALIGN uint32_t primitive[kPacketRays];
  HWY_ALIGN uint32_t back[kPacketRays];
};

// Rays from `first` on, one a lane.
struct RayLanes {
  using D = DNode;
  const RayColumns& rays;
  size_t first;

  HWY_ATTR hn::Vec<D> Origin(uint32_t axis) const { return hn::Load(D(), rays.origin[axis] + first); }
  HWY_ATTR hn::Vec<D> Direction(uint32_t axis) const { return hn::Load(D(), rays.direction[axis] + first); }
  HWY_ATTR hn::Vec<D> TMin() const { return hn::Load(D(), rays.t_min + first); }
  HWY_ATTR hn::Vec<D> Limit() const { return hn::Load(D(), rays.limit + first); }
  uint32_t Axis(int i) const { return rays.axis[i][0]; }
  HWY_ATTR hn::Vec<D> Shear(int i) const { return hn::Load(D(), rays.shear[i] + first); }
  HWY_ATTR hn::Vec<D> EdgeSlack() const { return hn::Load(D(), rays.edge_slack + first); }
  HWY_ATTR hn::Vec<D> DetSlack() const { return hn::Load(D(), rays.det_slack + first); }
  HWY_ATTR hn::Vec<D> EndSlack() const { return hn::Load(D(), rays.end_slack + first); }
  HWY_ATTR hn::Vec<hn::RebindToUnsigned<D>> Excluded() const {
    return hn::Load(hn::RebindToUnsigned<D>(), rays.excluded + first);
  }
};

// One of them, in all lanes.
struct OneOfRays {
  using D = DLeaf;
  const RayColumns& rays;
  size_t i;

  HWY_ATTR hn::Vec<D> Origin(uint32_t axis) const { return hn::Set(D(), rays.origin[axis][i]); }
  HWY_ATTR hn::Vec<D> Direction(uint32_t axis) const { return hn::Set(D(), rays.direction[axis][i]); }
  HWY_ATTR hn::Vec<D> TMin() const { return hn::Set(D(), rays.t_min[i]); }
  HWY_ATTR hn::Vec<D> Limit() const { return hn::Set(D(), rays.limit[i]); }
  uint32_t Axis(int k) const { return rays.axis[k][i]; }
  HWY_ATTR hn::Vec<D> Shear(int k) const { return hn::Set(D(), rays.shear[k][i]); }
  HWY_ATTR hn::Vec<D> EdgeSlack() const { return hn::Set(D(), rays.edge_slack[i]); }
  HWY_ATTR hn::Vec<D> DetSlack() const { return hn::Set(D(), rays.det_slack[i]); }
  HWY_ATTR hn::Vec<D> EndSlack() const { return hn::Set(D(), rays.end_slack[i]); }
  HWY_ATTR hn::Vec<hn::RebindToUnsigned<D>> Excluded() const {
    return hn::Set(hn::RebindToUnsigned<D>(), rays.excluded[i]);
  }
};

// One triangle of a leaf, in all lanes.
struct OneTriangle {
  using D = DNode;
  LeafView leaf;
  uint32_t lane;

  HWY_ATTR hn::Vec<D> Corner(int corner, uint32_t axis) const { return hn::Set(D(), leaf.Corner(corner, axis)[lane]); }
  HWY_ATTR hn::Vec<hn::RebindToUnsigned<D>> Ids() const { return hn::Set(hn::RebindToUnsigned<D>(), leaf.ids()[lane]); }
  HWY_ATTR hn::Mask<D> Valid() const { return hn::FirstN(D(), hn::MaxLanes(D())); }
  uint32_t Primitive() const { return leaf.Primitive(lane); }
};

// Whether so many of kWidth rays test so many triangles sooner together, triangle by triangle, than each by itself: as
// measured.
constexpr bool PaysTogether(uint32_t rays, uint32_t triangles) {
  return 2 * rays * ((triangles + kLeafLanes - 1) / kLeafLanes) > triangles;
}

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_LEAF_LANES_INL_H_
