// STL, the stereolithography format.

#ifndef SERVER_MESH_STL_READER_H_
#define SERVER_MESH_STL_READER_H_

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "server/mesh/face_collector.h"

namespace deltaray {

// The size of the binary STL file of so many triangles as the bytes announce. 0 where they are too few for that.
uint64_t BinaryStlSize(absl::string_view bytes);

// Whether the bytes are as long as a binary STL file of so many triangles as they announce. No other test is sure: the
// header of a binary file may well begin with "solid", and text is never that long for what stands in bytes 80 to 83.
bool HasBinaryStlSize(absl::string_view bytes);

// Whether `line` begins an ASCII file: "solid" in capitals or not.
bool BeginsAsciiStl(absl::string_view line);

// Reads an ASCII or binary file into `collector`. Equal positions become one vertex. In ASCII, each solid with a name
// is a group. Normals and attributes are passed over; the order of the corners says what is front. INVALID_ARGUMENT,
// naming the line or byte, for what is malformed, cut off, or too long.
absl::Status ReadStl(absl::string_view bytes, FaceCollector* collector);

}  // namespace deltaray

#endif  // SERVER_MESH_STL_READER_H_
