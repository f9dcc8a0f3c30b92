// The connection to one deltarayd.

#ifndef CLIENT_CONNECTION_H_
#define CLIENT_CONNECTION_H_

#include <memory>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/session.h"
#include "deltaray/v1/mesh_service.grpc.pb.h"
#include "deltaray/v1/ray_service.grpc.pb.h"
#include "grpcpp/client_context.h"

namespace deltaray {

class Connection {
 public:
  // Connects to session.server. Fails, with the exit code of UNAVAILABLE, where nobody listens there, or none answers
  // within session.timeout_seconds. The session must outlive the connection.
  static absl::StatusOr<Connection> Open(const Session& session);

  v1::MeshService::Stub& meshes() { return *meshes_; }
  v1::RayService::Stub& rays() { return *rays_; }
  StopSignal& stop() { return session_->stop; }

  // Runs a unary RPC, `call`, with a deadline of session.timeout_seconds.
  absl::Status Call(absl::FunctionRef<grpc::Status(grpc::ClientContext*)> call);

  // What an RPC of this connection ended with; Interrupted() where it was our own stop that cancelled it.
  absl::Status Result(const grpc::Status& status, const grpc::ClientContext& context);

 private:
  Connection(const Session& session, std::shared_ptr<grpc::Channel> channel);

  const Session* session_;
  std::unique_ptr<v1::MeshService::Stub> meshes_;
  std::unique_ptr<v1::RayService::Stub> rays_;
};

}  // namespace deltaray

#endif  // CLIENT_CONNECTION_H_
