#include "tests/torture/fleet.h"

#include <utility>

namespace deltaray {

Fleet::Fleet(int servers, std::string binary, std::string data_directory)
    : binary_(std::move(binary)), data_directory_(std::move(data_directory)), servers_(servers), addresses_(servers) {}

absl::Status Fleet::Start() {
  for (int i = 0; i < size(); ++i) {
    if (servers_[i]) continue;
    absl::StatusOr<std::unique_ptr<ServerProcess>> server =
        ServerProcess::Start(binary_, data_directory_, {"--tree-bytes", "48MB"});
    if (!server.ok()) return server.status();
    servers_[i] = *std::move(server);
    MutexLock lock(mutex_);
    addresses_[i] = servers_[i]->address();
  }
  return absl::OkStatus();
}

absl::Status Fleet::Kill(int server) { return std::exchange(servers_[server], nullptr)->Kill(); }

absl::Status Fleet::Stop() {
  absl::Status status;
  for (auto& server : servers_) {
    if (server) status.Update(std::exchange(server, nullptr)->Stop());
  }
  return status;
}

std::string Fleet::address(int server) const {
  MutexLock lock(mutex_);
  return addresses_[server];
}

absl::StatusOr<Connection*> FleetClient::To(int server) {
  Known& known = connections_[server];
  if (std::string address = fleet_.address(server); !known.connection || known.address != address) {
    known.connection.reset();
    absl::StatusOr<std::unique_ptr<BenchConnection>> connection = BenchConnection::Open(address);
    if (!connection.ok()) return connection.status();
    known = {std::move(address), *std::move(connection)};
  }
  return &**known.connection;
}

absl::StatusOr<v1::Mesh> GetMesh(Connection& connection, const std::string& mesh) {
  v1::GetMeshRequest request;
  request.set_mesh(mesh);
  v1::GetMeshResponse response;
  const absl::Status status = connection.CallOnce(
      mesh, [&](grpc::ClientContext* context) { return connection.meshes().GetMesh(context, request, &response); });
  if (!status.ok()) return status;
  return response.mesh();
}

absl::StatusOr<std::vector<v1::Mesh>> ListMeshes(Connection& connection) {
  std::vector<v1::Mesh> meshes;
  v1::ListMeshesRequest request;
  do {
    v1::ListMeshesResponse response;
    const absl::Status status = connection.CallOnce(
        "", [&](grpc::ClientContext* context) { return connection.meshes().ListMeshes(context, request, &response); });
    if (!status.ok()) return status;
    meshes.insert(meshes.end(), response.meshes().begin(), response.meshes().end());
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return meshes;
}

absl::Status NameMesh(Connection& connection, const std::string& name, const std::string& mesh) {
  v1::NameMeshRequest request;
  request.set_name(name);
  request.set_mesh(mesh);
  v1::NameMeshResponse response;
  return connection.CallOnce(
      mesh, [&](grpc::ClientContext* context) { return connection.meshes().NameMesh(context, request, &response); });
}

absl::Status RebuildMesh(Connection& connection, const std::string& mesh, uint32_t delta) {
  v1::RebuildMeshRequest request;
  request.set_mesh(mesh);
  request.mutable_build_options()->set_delta(delta);
  v1::RebuildMeshResponse response;
  return connection.CallOnce(
      mesh, [&](grpc::ClientContext* context) { return connection.meshes().RebuildMesh(context, request, &response); });
}

}  // namespace deltaray
