// The connection to one deltarayd, or to a balancer before several.

#ifndef CLIENT_CONNECTION_H_
#define CLIENT_CONNECTION_H_

#include <chrono>
#include <memory>
#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "client/session.h"
#include "deltaray/v1/mesh_service.grpc.pb.h"
#include "deltaray/v1/ray_service.grpc.pb.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "grpcpp/channel.h"
#include "grpcpp/client_context.h"

namespace deltaray {

// The contract's limit of a message.
constexpr int kMaxMessageBytes = 64 << 20;

class Connection {
 public:
  // Connects to session.server. Fails, with the exit code of UNAVAILABLE, where nobody listens there, TLS does not come
  // about, or none answers within session.timeout_seconds. The session must outlive the connection.
  static absl::StatusOr<Connection> Open(const Session& session);

  v1::MeshService::Stub& meshes() { return *meshes_; }
  v1::RayService::Stub& rays() { return *rays_; }
  grpc::health::v1::Health::Stub& health() { return *health_; }
  StopSignal& stop() { return session_->stop; }
  const Session& session() const { return *session_; }

  // Runs a unary RPC, `call`, with a deadline of session.timeout_seconds. `mesh`: the id or name that it is about, or
  // empty. CallAgain is for what changes nothing: it calls once more where the server is lost, with back-off, until
  // session.retry_seconds have passed.
  absl::Status CallOnce(absl::string_view mesh, absl::FunctionRef<grpc::Status(grpc::ClientContext*)> call);
  absl::Status CallAgain(absl::string_view mesh, absl::FunctionRef<grpc::Status(grpc::ClientContext*)> call);

  // Readies the context of an RPC about `mesh`, an id or name or empty: gives it the token, and the metadata
  // `deltaray-mesh`, by which balancers send all calls about one mesh to the same server. Names travel there with
  // %XX in place of bytes that are not printable ASCII.
  void Prepare(absl::string_view mesh, grpc::ClientContext* context) const;

  // Waits for as long, or until the program is stopped, and meanwhile connects anew where the connection is lost: while
  // no call is under way, gRPC by itself looks only every 5 s at what has become of it.
  void Wait(std::chrono::milliseconds time) const;

  // What an RPC of this connection ended with; Interrupted() where it was our own stop that cancelled it.
  absl::Status Result(const grpc::Status& status);

 private:
  Connection(const Session& session, std::string token, std::shared_ptr<grpc::Channel> channel);

  grpc::Status Call(absl::string_view mesh, absl::FunctionRef<grpc::Status(grpc::ClientContext*)> call);

  const Session* session_;
  std::string token_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::MeshService::Stub> meshes_;
  std::unique_ptr<v1::RayService::Stub> rays_;
  std::unique_ptr<grpc::health::v1::Health::Stub> health_;
};

}  // namespace deltaray

#endif  // CLIENT_CONNECTION_H_
