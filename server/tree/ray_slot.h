// A ray on its way through a wide tree, in the tree's frame.

#ifndef SERVER_TREE_RAY_SLOT_H_
#define SERVER_TREE_RAY_SLOT_H_

#include <cstddef>
#include <cstdint>
#include <limits>

#include "server/geometry/ray.h"
#include "server/tree/wide_node.h"

namespace deltaray {

// The limit of a ray whose answer is known.
inline constexpr float kNothingMatters = -std::numeric_limits<float>::infinity();

// A triangle that may be the answer.
struct Suspect {
  uint32_t leaf = 0;  // bits of ChildRef
  uint32_t lane = 0;
};

// The frame: coordinates times 2^scale_exponent; directions times the power of two that brings the greatest component
// to [1, 2); t times what makes up for both. README.md derives the bounds.
struct alignas(64) RaySlot {
  // What node tests read: one cache line. The slab of an axis is entered at inverse * near plane + near_offset, and
  // left at inverse * far plane + far_offset; the offsets hold the origin, and widen the slab by more than all
  // roundings.
  float inverse[3];
  float t_min;
  float near_offset[3];
  float limit;  // hits beyond this do not matter
  float far_offset[3];
  int32_t limit_key;    // LimitKey of it
  uint32_t flip[3];     // bytes from an axis' lower faces to its near ones
  uint32_t stack_size;  // the bottom included

  // Nodes and leaves that are still to be looked at, the nearest last, and below them what says that there are none.
  // There is room for a register more than are ever on it, since whole ones are stored.
  int32_t* keys;
  uint32_t* refs;

  // What leaf tests read.
  float origin[3];
  uint32_t current;  // bits of the ChildRef that is next
  float direction[3];
  uint32_t excluded;  // primitive
  // At kExact: factors of error bounds, see ExactTest.
  float edge_slack;
  float det_slack;
  float end_slack;
  double t_unscale;  // t in the frame times this is the ray's t
  uint32_t ray;      // index in the batch
  uint32_t exact;    // whether origin, direction and ends are the ray's own, but for powers of two

  // The answer so far; at kExact, of the suspects that were decided to make room.
  uint32_t primitive;
  uint32_t suspect_count;
  float t, u, v;
  uint32_t back;
  // At kWatertight: the axes' order, the greatest component of the direction last, and the shear along it.
  uint32_t axis[3];
  float shear[3];

  // At kExact: who may be the answer, each with a lower bound of its t.
  static constexpr uint32_t kMaxSuspects = 8;
  float suspect_t[kMaxSuspects];
  Suspect suspects[kMaxSuspects];

  // Whether there is an answer other than that nothing is hit, as far as is known. Without a branch.
  bool MayHit() const { return (static_cast<uint32_t>(primitive != kNoPrimitive) | suspect_count) != 0; }
};

}  // namespace deltaray

#endif  // SERVER_TREE_RAY_SLOT_H_
