// From the bytes of a file to a validated mesh. The bytes are hostile.

#ifndef SERVER_MESH_READ_MESH_H_
#define SERVER_MESH_READ_MESH_H_

#include <cstdint>
#include <functional>
#include <span>

#include "absl/status/statusor.h"
#include "server/mesh/triangle_mesh.h"

namespace deltaray {

enum class MeshFormat : uint8_t { kDetect, kObj, kPly, kStl, kRaw };

// Layout of raw indexed arrays: vertex_count × 3 positions, then triangle_count × 3 uint32, little-endian.
struct RawLayout {
  uint64_t vertex_count = 0;
  uint64_t triangle_count = 0;
  bool float64 = false;
};

// Limits on what a file may hold. What is over one gives RESOURCE_EXHAUSTED and a text that names the limit.
struct MeshLimits {
  uint64_t max_triangles = 100'000'000;
  uint64_t max_vertices = 100'000'000;
  uint64_t max_face_corners = 65'536;   // corners of one polygon
  uint64_t max_line_bytes = 1'048'576;  // bytes of a line of a text format
  uint64_t max_groups = 65'536;
  uint64_t max_group_name_bytes = 1'024;
  uint64_t max_group_bytes = 16'777'216;  // of the names of all groups
};

struct ReadMeshOptions {
  MeshFormat format = MeshFormat::kDetect;
  RawLayout raw;  // kRaw only
  MeshLimits limits;
  // Asked now and then; reading ends with CANCELLED once it returns true.
  std::function<bool()> cancelled;
  // Asked before reading takes up to so many bytes of memory in all, the finished mesh included; each time for more.
  // Reading ends with its error. May be empty.
  std::function<absl::Status(uint64_t bytes)> take_memory;
};

struct ReadMeshResult {
  TriangleMesh mesh;
  MeshReport report;
  MeshFormat format = MeshFormat::kDetect;  // the format found
};

// Reads a mesh: a pure function of the bytes and the options. A file without any triangle is a valid empty mesh if its
// format says so in full (PLY, STL, raw; an OBJ with vertices only). Errors, which name the line or byte:
// INVALID_ARGUMENT for what is malformed; RESOURCE_EXHAUSTED for what is over a limit, with the limit's name and value,
// or where memory does not suffice; CANCELLED. Thread-safe.
//
// Coordinates are read as float64, rounded right, and have to be in the range of float32. Stored are float32 relative
// to an origin. It is zero where no coordinate is farther from zero than 16 times the mesh's extent: then rounding
// moves no vertex by more than 2^-20 of the extent. Else it is near the mesh's centre, a multiple of a power of two in
// each coordinate, or zero where float32 holds all vertices exactly, but would not relative to that centre. So what is
// exact in float32 keeps its value in any case; -0 becomes +0.
absl::StatusOr<ReadMeshResult> ReadMesh(std::span<const char> bytes, const ReadMeshOptions& options);

}  // namespace deltaray

#endif  // SERVER_MESH_READ_MESH_H_
