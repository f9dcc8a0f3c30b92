// Wavefront OBJ.

#ifndef SERVER_MESH_OBJ_READER_H_
#define SERVER_MESH_OBJ_READER_H_

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "server/mesh/face_collector.h"

namespace deltaray {

// Whether `line`, without leading spaces, begins with a statement of OBJ. A comment does not count.
bool IsObjStatement(absl::string_view line);

// Reads vertices, faces (`f`, `fo`) and groups (the last `g` or `o`) of an OBJ file into `collector`. Lines that end in
// a backslash go on in the next one. Normals, texture coordinates and materials are passed over, `mtllib` never opens a
// file; points, lines, curves and surfaces are passed over with a warning. INVALID_ARGUMENT, naming the line, for what
// is not OBJ, for indices that are zero or out of range, and for a file without any vertex.
absl::Status ReadObj(absl::string_view text, FaceCollector* collector);

}  // namespace deltaray

#endif  // SERVER_MESH_OBJ_READER_H_
