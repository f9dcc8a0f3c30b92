// Planes that split a cell of space, as a kd-tree does.

#ifndef SERVER_BUILD_KD_PLANE_H_
#define SERVER_BUILD_KD_PLANE_H_

#include <limits>
#include <span>

#include "server/build/reference.h"
#include "server/build/sah.h"
#include "server/geometry/bounds.h"

namespace deltaray {

// The plane where coordinate `axis` is `position`. Boxes that only touch it lie on one side; those that lie in it go to
// the left or to the right as a whole.
struct KdPlane {
  double cost = std::numeric_limits<double>::infinity();  // infinite: no plane was found
  int axis = 0;
  float position = 0;
  bool flat_left = true;

  bool IsFound() const { return cost < std::numeric_limits<double>::infinity(); }
  bool OverlapsLeft(const Bounds& box) const { return box.min[axis] < position || (flat_left && IsFlat(box)); }
  bool OverlapsRight(const Bounds& box) const { return box.max[axis] > position || (!flat_left && IsFlat(box)); }

 private:
  bool IsFlat(const Bounds& box) const { return box.min[axis] == position && box.max[axis] == position; }
};

// The plane across `axis`, strictly within `cell`, of least SAH cost for boxes that overlap `cell`: of all planes
// through faces of boxes where there are few references, else of 63 at even distances. A plane with nothing on one side
// costs less by the part `empty_space_bonus`. Sources: [Wald and Havran 2006], section 4.2; [Wald 2007].
KdPlane FindKdPlane(std::span<const Reference> references, const Bounds& cell, int axis, const SahCosts& costs,
                    double empty_space_bonus);

}  // namespace deltaray

#endif  // SERVER_BUILD_KD_PLANE_H_
