// PLY, the Stanford polygon format.

#ifndef SERVER_MESH_PLY_READER_H_
#define SERVER_MESH_PLY_READER_H_

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "server/mesh/face_collector.h"

namespace deltaray {

// Whether the bytes begin as a PLY file does.
bool LooksLikePly(absl::string_view bytes);

// Reads x, y, z of the element "vertex" and the list "vertex_indices" or "vertex_index" of the element "face" into
// `collector`; ASCII or binary of either order, in any order of elements and properties, of any types. All else is
// passed over, as is what follows the last element, with a warning. In ASCII each row is one line. INVALID_ARGUMENT,
// naming the line, or the byte in a binary body, for what is malformed or cut off, and for triangle strips.
absl::Status ReadPly(absl::string_view bytes, FaceCollector* collector);

}  // namespace deltaray

#endif  // SERVER_MESH_PLY_READER_H_
