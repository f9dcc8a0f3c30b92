// The rays of a packet in the frame of a wide tree, set up all at once.

#if defined(SERVER_TREE_PACKET_RAYS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_PACKET_RAYS_INL_H_
#undef SERVER_TREE_PACKET_RAYS_INL_H_
#else
#define SERVER_TREE_PACKET_RAYS_INL_H_
#endif

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>

#include "hwy/highway.h"
#include "server/geometry/ray.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/node_test-inl.h"
#include "server/tree/ray_setup-inl.h"
#include "server/tree/ray_slot.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// What RaySetup makes of each ray, by the same operations: the same bits.
class PacketRays {
  using V = hn::Vec<DNode>;

 public:
  // `slots`: one for each ray, for Slot().
  explicit PacketRays(RaySlot* slots) : slots_(slots) {}

  // Sets up rays, the first of which has the index `first` in the batch, with all directions scaled by 2^-exponent.
  // REQUIRES: as many rays as a packet has, none of them odd.
  template <bool kExact>
  HWY_ATTR void SetUp(const RaySetup<kExact>& setup, std::span<const Ray> rays, uint32_t first, int exponent) {
    first_ = first;
    slots_made_ = 0;
    t_unscale_ = setup.TUnscale(exponent);
    for (size_t part = 0; part < kPacketRays; part += kWidth) SetUpPart(setup, rays, part, exponent);
  }

  RayColumns& columns() { return columns_; }
  // Index of ray 0 in the batch.
  uint32_t first() const { return first_; }
  // t in the frame times this is the rays' t.
  double t_unscale() const { return t_unscale_; }

  // The slot of a ray, as far as suspects and decisions need it. Its limit is its own from the first call on.
  HWY_ATTR HWY_INLINE RaySlot& Slot(size_t i) {
    if ((slots_made_ >> i & 1) == 0) MakeSlot(i);
    return slots_[i];
  }
  // nullptr: Slot() was never called.
  RaySlot* SlotIfMade(size_t i) { return (slots_made_ >> i & 1) == 0 ? nullptr : &slots_[i]; }

 private:
  template <bool kExact>
  HWY_ATTR HWY_INLINE void SetUpPart(const RaySetup<kExact>& setup, std::span<const Ray> rays, size_t part,
                                     int exponent) {
    using Setup = RaySetup<kExact>;
    const DNode d;
    const DNodeInt di;
    const DNodeUint du;
    const auto at = hn::Mul(hn::Iota(di, 0), hn::Set(di, sizeof(Ray) / sizeof(float)));
    static_assert(sizeof(Ray) % sizeof(float) == 0);
    const auto given = [&](const float& of_first) HWY_ATTR { return hn::GatherIndex(d, &of_first, at); };
    const V direction_scale = hn::Set(d, Setup::DirectionScale(exponent));
    const double t_scale = setup.TScale(exponent);
    V direction[3], origin[3], farthest = hn::Zero(d), length = hn::Zero(d);
    auto rounded = hn::FirstN(d, 0);
    for (size_t axis = 0; axis < 3; ++axis) {
      const V given_origin = given((&rays[part].origin.x)[axis]);
      const V given_direction = given((&rays[part].direction.x)[axis]);
      origin[axis] = Setup::Times(given_origin, setup.scale());
      direction[axis] = hn::Mul(given_direction, direction_scale);
      hn::Store(origin[axis], d, columns_.origin[axis] + part);
      hn::Store(direction[axis], d, columns_.direction[axis] + part);
      farthest = hn::Max(farthest, hn::Abs(origin[axis]));
      if constexpr (kExact) {
        length = hn::Add(length, hn::Abs(direction[axis]));
        rounded = hn::Or(rounded, hn::Or(Setup::MayHaveRounded(given_direction, direction[axis]),
                                         Setup::MayHaveRounded(given_origin, origin[axis])));
      }
    }
    const V reach = hn::Add(farthest, hn::Set(d, 1.0f)), twice = hn::Add(reach, reach);
    for (size_t axis = 0; axis < 3; ++axis) {
      const V inverse = Setup::Inverse(direction[axis]);
      const V centre = hn::Neg(hn::Mul(origin[axis], inverse));
      const V pad = Setup::Pad(direction[axis], inverse, reach);
      hn::Store(inverse, d, columns_.inverse[axis] + part);
      hn::Store(hn::Sub(centre, pad), d, columns_.near_offset[axis] + part);
      hn::Store(hn::Add(centre, pad), d, columns_.far_offset[axis] + part);
    }
    const V given_t_min = given(rays[part].t_min), given_t_max = given(rays[part].t_max);
    const V scaled_t_min = Setup::Times(given_t_min, t_scale), scaled_t_max = Setup::Times(given_t_max, t_scale);
    const V t_min = hn::Max(scaled_t_min, hn::Neg(twice)), t_max = hn::Min(scaled_t_max, twice);
    hn::Store(t_min, d, columns_.t_min + part);
    hn::Store(hn::IfThenElse(hn::Le(t_min, t_max), t_max, hn::Set(d, kNothingMatters)), d, columns_.limit + part);
    hn::Store(hn::GatherIndex(du, &rays[part].excluded_primitive, at), du, columns_.excluded + part);
    if constexpr (kExact) {
      hn::Store(hn::Mul(hn::Set(d, Setup::kEdgeSlack), length), d, columns_.edge_slack + part);
      hn::Store(hn::Mul(hn::Set(d, Setup::kDetSlack), length), d, columns_.det_slack + part);
      hn::Store(hn::Mul(hn::Set(d, Setup::kEndSlack), length), d, columns_.end_slack + part);
      rounded = hn::Or(rounded, hn::Or(Setup::MayHaveRounded(given_t_min, scaled_t_min),
                                       Setup::MayHaveRounded(given_t_max, scaled_t_max)));
      const auto exact = hn::Set(du, setup.exact_corners() ? 1 : 0);
      hn::Store(hn::IfThenZeroElse(hn::RebindMask(du, rounded), exact), du, columns_.exact + part);
    } else {
      hn::Store(hn::Set(d, std::numeric_limits<float>::infinity()), d, columns_.t + part);
      hn::Store(hn::Zero(d), d, columns_.u + part);
      hn::Store(hn::Zero(d), d, columns_.v + part);
      hn::Store(hn::Set(du, kNoPrimitive), du, columns_.primitive + part);
      hn::Store(hn::Zero(du), du, columns_.back + part);
    }
  }

  HWY_ATTR void MakeSlot(size_t i) {
    slots_made_ |= 1u << i;
    RaySlot& slot = slots_[i];
    for (int axis = 0; axis < 3; ++axis) {
      slot.origin[axis] = columns_.origin[axis][i];
      slot.direction[axis] = columns_.direction[axis][i];
    }
    slot.t_unscale = t_unscale_;
    slot.ray = first_ + static_cast<uint32_t>(i);
    slot.exact = columns_.exact[i];
    slot.primitive = kNoPrimitive;
    slot.suspect_count = 0;
    SetLimit(slot, columns_.limit[i]);
  }

  RaySlot* const slots_;
  uint32_t first_ = 0;
  uint32_t slots_made_ = 0;  // a bit a ray
  double t_unscale_ = 1;
  RayColumns columns_;
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_PACKET_RAYS_INL_H_
