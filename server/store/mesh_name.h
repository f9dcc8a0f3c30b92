// What tells mesh ids from names.

#ifndef SERVER_STORE_MESH_NAME_H_
#define SERVER_STORE_MESH_NAME_H_

#include "absl/strings/string_view.h"

namespace deltaray {

// Whether `text` has the form of a mesh id: 64 lower-case hexadecimal digits. ValidateMeshName is in mesh_store.h.
bool IsMeshId(absl::string_view text);

}  // namespace deltaray

#endif  // SERVER_STORE_MESH_NAME_H_
