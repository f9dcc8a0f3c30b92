// Bounds of parts of a triangle, for spatial splits.

#ifndef SERVER_GEOMETRY_CLIP_TRIANGLE_H_
#define SERVER_GEOMETRY_CLIP_TRIANGLE_H_

#include "server/geometry/bounds.h"
#include "server/geometry/triangles.h"

namespace deltaray {

// A box that holds every point that `triangle` and the closed `box` share, and lies within `box` and within the
// triangle's own bounds. Wider than the tightest such box by rounding only: about one float32 step at each face, more
// where a face of `box` is nearly parallel to the triangle. Empty only where nothing is shared; a box that is just
// missed may still give a box without width.
//
// `box` may be unbounded (infinite faces) or empty. Degenerate triangles are clipped as the segments or points that
// they are. Source of the method: [Sutherland and Hodgman 1974]; the error bound is in README.md.
Bounds ClipTriangle(const Triangle& triangle, const Bounds& box);

// Splits the part of `triangle` within `box` at the plane where coordinate `axis` is `position`: `left` becomes what
// ClipTriangle gives for the part of `box` where the coordinate is <= position, `right` for that where it is >=
// position, up to rounding. A part that lies in the plane is in both.
void SplitTriangle(const Triangle& triangle, int axis, float position, const Bounds& box, Bounds* left, Bounds* right);

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_CLIP_TRIANGLE_H_
