// From the float64 coordinates of a file to stored float32 positions.

#ifndef SERVER_MESH_ORIGIN_H_
#define SERVER_MESH_ORIGIN_H_

#include <vector>

#include "server/mesh/polygon_mesh.h"

namespace deltaray {

// The point that the stored positions are relative to.
//
// It is zero where the mesh is not far from zero: no coordinate is more than 16 times the mesh's extent away (its
// widest axis), so that rounding to float32 moves no vertex by more than 2^-20 of the extent. Ordinary files are of
// that kind, though 0.1 is not exact. Else, it is the centre of the bounds, each coordinate rounded to a multiple of
// the least power of two that is not below the extent. So few bits keep the subtraction from rounding in all but odd
// cases, and leave an axis that is near zero at zero. Only vertices that a face uses count here.
//
// That is so where float32 holds all vertices exactly, too, since rays in float64 would be rounded as coarsely as
// float32 is spaced there; but not where it would not hold them relative to that point.
Vec3d ChooseOrigin(const PolygonMesh& mesh);
// Of a mesh whose positions are relative to zero.
Vec3d ChooseOrigin(const TriangleMesh& mesh);

// A vertex minus `origin`: subtracted in double, which may round, and then rounded to float32; -0 is stored as +0.
inline Vec3f StoredPosition(const Vec3d& vertex, const Vec3d& origin) {
  return static_cast<Vec3f>(vertex - origin) + Vec3f{0, 0, 0};
}

struct StoredPositions {
  std::vector<Vec3f> positions;
  // The largest |origin + stored - given| of any coordinate of any vertex.
  double max_rounding = 0;
};

// StoredPosition of each.
StoredPositions StorePositions(const std::vector<Vec3d>& vertices, const Vec3d& origin);

}  // namespace deltaray

#endif  // SERVER_MESH_ORIGIN_H_
