// Coherent rays through a wide tree, many together.

#if defined(SERVER_TREE_PACKET_TRAVERSAL_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_PACKET_TRAVERSAL_INL_H_
#undef SERVER_TREE_PACKET_TRAVERSAL_INL_H_
#else
#define SERVER_TREE_PACKET_TRAVERSAL_INL_H_
#endif

#include <cstdint>
#include <new>
#include <span>

#include "hwy/highway.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/node_test-inl.h"
#include "server/tree/packet_bounds-inl.h"
#include "server/tree/packet_rays-inl.h"
#include "server/tree/queries-inl.h"
#include "server/tree/ray_kernels.h"
#include "server/tree/ray_setup-inl.h"
#include "server/tree/traversal_scratch.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// A packet is led through the nodes as the interval of all its rays [Boulos 2006]: one test of a node's boxes for all
// of them. At a leaf each ray tries the leaf's box, and those that meet it test the leaf's triangles, each by itself or
// together, with the same operations as if they were alone, so that answers are the same bits.
template <typename Query>
class PacketTraversal {
  using Setup = RaySetup<Query::Test::kExact>;
  using VNode = hn::Vec<DNode>;

 public:
  PacketTraversal(const WideScene& scene, Query& query)
      : base_(scene.arrays.block.data()),
        query_(query),
        stop_(scene.stop),
        setup_(scene.arrays),
        scratch_(StackEntries(scene.arrays.levels), 1, kPacketRays),
        packet_(scratch_.slots()) {}

  enum class Outcome : uint8_t {
    kTraced,
    kRefused,  // at once: the rays do not go the same way
    kGaveUp,   // on the way: where they go, too few rays come to the same leaf for a packet to pay
  };

  // Traces the rays, the first of which has the index `first` in the batch; or else has answered none. `always`: takes
  // packets however wide, and does not give up. REQUIRES: as many rays as a packet has.
  HWY_ATTR Outcome Trace(std::span<const Ray> rays, uint32_t first, bool always) {
    if (!bounds_.Find(rays, setup_, always)) return Outcome::kRefused;
    given_ = rays;
    first_ = first;
    rays_are_set_up_ = false;
    if (!Traverse(always)) return Outcome::kGaveUp;
    if (rays_are_set_up_) {
      query_.EndRays(packet_);
    } else {
      for (uint32_t i = 0; i < kPacketRays; ++i) query_.Miss(first + i);
    }
    return Outcome::kTraced;
  }

 private:
  // Sets up all rays: not before one has come to a leaf.
  HWY_ATTR HWY_INLINE void SetUpRays() {
    if (HWY_LIKELY(rays_are_set_up_)) return;
    rays_are_set_up_ = true;
    // None is odd, by PacketBounds.
    packet_.SetUp(setup_, given_, first_, bounds_.exponent());
    Query::Test::SetUp(packet_.columns());
  }

  // False: gave up. Ends where it is to stop.
  HWY_ATTR bool Traverse(bool always) {
    uint32_t leaves = 0, tests = 0;
    PacketStack stack{scratch_.keys(), scratch_.refs(), scratch_.parents()};
    uint32_t size = 0;
    uint32_t current = ChildRef::Node(0).bits();
    uint32_t parent = 0;
    while (true) {
      const ChildRef ref(current);
      if (HWY_UNLIKELY(stop_.Step(ref.IsLeaf() ? kPacketRays : 1))) return true;
      if (ref.IsLeaf()) {
        ++leaves;
        tests += VisitLeaf(ref, parent);
        if (HWY_UNLIKELY(tests < leaves && leaves > kTrialLeaves && !always)) return false;
      } else {
        size = Push(ref.offset(), stack, size);
      }
      // The nearest one that still matters.
      do {
        if (size == 0) return true;
        --size;
      } while (stack.keys[size] > bounds_.limit_key());
      current = stack.refs[size];
      parent = stack.parents[size];
    }
  }

  struct PacketStack {
    int32_t* keys;
    uint32_t* refs;
    uint32_t* parents;  // the node's offset, of which a leaf is a child
  };

  // Pushes the children that some ray of the packet may enter. Returns the stack's size.
  HWY_ATTR HWY_INLINE uint32_t Push(uint32_t node_offset, const PacketStack& stack, uint32_t size) {
    const std::byte* const node = base_ + node_offset * kUnitBytes;
    const NodeHits hits = bounds_.Test(node);
    const size_t count = PushSorted(node, hits.near, hits.mask, stack.keys + size, stack.refs + size);
    for (size_t i = 0; i < count; ++i) stack.parents[size + i] = node_offset;
    return size + static_cast<uint32_t>(count);
  }

  // Lets the rays that meet the leaf's box test it, and returns how many do.
  HWY_ATTR HWY_INLINE uint32_t VisitLeaf(ChildRef leaf, uint32_t parent) {
    const DNode d;
    SetUpRays();
    const RayColumns& rays = packet_.columns();
    const std::byte* const node = base_ + parent * kUnitBytes;
    // Which child of its parent the leaf is, tells where its box is.
    const hn::RebindToUnsigned<DNode> du;
    const auto children = hn::Load(du, reinterpret_cast<const uint32_t*>(node + 6 * kUnitBytes));
    const size_t lane = hn::FindFirstTrue(du, hn::Eq(children, hn::Set(du, leaf.bits())));
    const auto face = [&](int axis, uint32_t upper) HWY_ATTR {
      return hn::Set(d, *(reinterpret_cast<const float*>(node + 2 * axis * kUnitBytes + upper) + lane));
    };
    const VNode near_x = face(0, bounds_.flip(0)), near_y = face(1, bounds_.flip(1)), near_z = face(2, bounds_.flip(2));
    const VNode far_x = face(0, kUnitBytes - bounds_.flip(0)), far_y = face(1, kUnitBytes - bounds_.flip(1)),
                far_z = face(2, kUnitBytes - bounds_.flip(2));
    const LeafView view{reinterpret_cast<const float*>(base_ + leaf.offset() * kUnitBytes), leaf.triangles()};
    uint32_t tests = 0;
    bool may_be_closer = false;
    for (size_t first = 0; first < kPacketRays; first += kWidth) {
      const auto cross = [&](VNode plane, int axis, const float* offset) HWY_ATTR {
        return hn::MulAdd(plane, hn::Load(d, rays.inverse[axis] + first), hn::Load(d, offset + first));
      };
      const VNode near = hn::Max(hn::Max(cross(near_x, 0, rays.near_offset[0]), cross(near_y, 1, rays.near_offset[1])),
                                 hn::Max(cross(near_z, 2, rays.near_offset[2]), hn::Load(d, rays.t_min + first)));
      const VNode far = hn::Min(hn::Min(cross(far_x, 0, rays.far_offset[0]), cross(far_y, 1, rays.far_offset[1])),
                                hn::Min(cross(far_z, 2, rays.far_offset[2]), hn::Load(d, rays.limit + first)));
      const auto met = hn::Le(near, far);
      const auto count = static_cast<uint32_t>(hn::CountTrue(d, met));
      tests += count;
      const bool together = PaysTogether(count, view.count) && rays.same_axes;
      may_be_closer |= together ? TestTogether(leaf, view, first, met) : TestApart(leaf, view, first, met);
    }
    if (may_be_closer) UpdateLimit();
    return tests;
  }

  // Lets each of the rays in the lanes `met`, from `first` on, test a leaf. Whether there may be hits.
  HWY_ATTR HWY_INLINE bool TestApart(ChildRef leaf, const LeafView& view, size_t first, hn::Mask<DNode> met) {
    // Rays with hits are set aside, so that no branch is taken per ray.
    size_t hit_count = 0;
    ForEach(DNode(), met, [&](uint32_t lane) HWY_ATTR {
      for (uint32_t part = 0; part < view.count; part += kLeafLanes) {
        // In place, as in BatchTraversal.
        const OneOfRays ray{packet_.columns(), first + lane};
        const auto* const hit = new (&hits_[hit_count])
            LeafHit{Query::Test::Start(ray, LeafLanes{view, part}), static_cast<uint32_t>(first + lane), part};
        hit_count += !hn::AllFalse(DLeaf(), hit->start.mask);
      }
    });
    for (size_t i = 0; i < hit_count; ++i) {
      query_.TakeOne(packet_, hits_[i].ray, leaf, view, hits_[i].first, hits_[i].start);
    }
    return hit_count > 0;
  }

  // The same, all rays together, one triangle after the other. REQUIRES: the rays' axes are the same.
  HWY_ATTR HWY_INLINE bool TestTogether(ChildRef leaf, const LeafView& view, size_t first, hn::Mask<DNode> met) {
    const DNode d;
    bool any = false;
    for (uint32_t lane = 0; lane < view.count; ++lane) {
      const OneTriangle triangle{view, lane};
      auto start = Query::Test::Start(RayLanes{packet_.columns(), first}, triangle);
      start.mask = hn::And(start.mask, met);
      if (hn::AllFalse(d, start.mask)) continue;
      any = true;
      query_.TakeRays(packet_, first, leaf, triangle, start);
    }
    return any;
  }

  // A ray that a leaf, or a part of one, has hits for.
  struct LeafHit {
    typename Query::First start;
    uint32_t ray, first;
  };

  HWY_ATTR HWY_INLINE void UpdateLimit() {
    const DNode d;
    const float* const limit = packet_.columns().limit;
    VNode greatest = hn::Load(d, limit);
    for (size_t i = kWidth; i < kPacketRays; i += kWidth) greatest = hn::Max(greatest, hn::Load(d, limit + i));
    bounds_.SetLimit(hn::GetLane(hn::MaxOfLanes(d, greatest)));
  }

  // Leaves that a packet comes to before it is asked whether it pays: at less than a test each, it does not.
  static constexpr uint32_t kTrialLeaves = 32;

  const std::byte* const base_;
  Query& query_;
  StopPoll& stop_;
  const Setup setup_;
  TraversalScratch scratch_;

  std::span<const Ray> given_;
  uint32_t first_ = 0;
  bool rays_are_set_up_ = false;
  PacketBounds<Setup> bounds_;
  PacketRays packet_;
  // One more than there can be: the next one is written in advance.
  LeafHit hits_[kWidth * kLeafParts + 1];
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_PACKET_TRAVERSAL_INL_H_
