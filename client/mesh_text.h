// Meshes and build options as text for people.

#ifndef CLIENT_MESH_TEXT_H_
#define CLIENT_MESH_TEXT_H_

#include <string>

#include "deltaray/v1/mesh.pb.h"
#include "google/protobuf/repeated_field.h"

namespace deltaray {

// One row a mesh, with a header; nothing where there is none.
std::string MeshListText(const google::protobuf::RepeatedPtrField<v1::Mesh>& meshes);

// All about one mesh, one fact a line.
std::string MeshText(const v1::Mesh& mesh);

// "hybrid, balanced preset, delta 32, alpha 0.6"; what is unset is left out.
std::string BuildOptionsText(const v1::BuildOptions& options);

}  // namespace deltaray

#endif  // CLIENT_MESH_TEXT_H_
