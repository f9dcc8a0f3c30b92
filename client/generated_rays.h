// Rays made for a mesh, for who has none of their own.

#ifndef CLIENT_GENERATED_RAYS_H_
#define CLIENT_GENERATED_RAYS_H_

#include <cstdint>

#include "absl/status/status.h"
#include "client/connection.h"
#include "deltaray/v1/mesh.pb.h"
#include "deltaray/v1/ray_service.pb.h"

namespace deltaray {

enum class GeneratedRays {
  kCamera,  // a picture of the whole mesh, as `render` frames it; neighbours are alike
  kChords,  // between random points of a sphere about the mesh
  kBounce,  // from where camera rays hit, off the surface, as diffuse light leaves it; in random order
  kShadow,  // from where camera rays hit to a light beside the viewer; in random order
};

// Fills in the layout and the rays of `request`, for kShadow also t_max = 1, the light; kBounce and kShadow ignore the
// triangle that they start on. The same `seed` gives the same rays. kBounce and kShadow ask the server for the hits
// that they start from. A LocalError where the mesh is empty, or no camera ray hits it.
absl::Status GenerateRays(Connection& connection, const v1::Mesh& mesh, GeneratedRays kind, uint32_t count,
                          uint64_t seed, v1::CompareAccuracyRequest* request);

}  // namespace deltaray

#endif  // CLIENT_GENERATED_RAYS_H_
