// Ids and names of meshes, as the command line gives them and as they are told.

#ifndef CLIENT_MESH_KEY_H_
#define CLIENT_MESH_KEY_H_

#include <functional>
#include <string>

#include "CLI/App.hpp"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "client/session.h"

namespace deltaray {

// A check of an option whose text goes into a message. protobuf would send what is not UTF-8, and complain on standard
// error.
std::string Utf8(const std::string& text);

// Adds the argument MESH, an id or a name, which has to be given.
void AddMeshArgument(CLI::App& command, std::function<void(const std::string&)> set);

// Writes the id that an answer has to standard output, a line of its own. A LocalError where it has none.
absl::Status WriteMeshId(const Session& session, absl::string_view id);

}  // namespace deltaray

#endif  // CLIENT_MESH_KEY_H_
