#include "client/connection.h"

#include <chrono>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/support/channel_arguments.h"

namespace deltaray {
namespace {

// The contract's limit of a message.
constexpr int kMaxMessageBytes = 64 << 20;

// A server that has vanished, cable and all, is noticed after these. The server's end pings far more often; a client
// that pings more than every 5 minutes would be cut off by gRPC's default policy.
constexpr int kKeepaliveMs = 360'000;
constexpr int kKeepaliveTimeoutMs = 20'000;

// How long a stop of the program may go unnoticed while connecting.
constexpr std::chrono::milliseconds kPollInterval(100);

std::chrono::system_clock::time_point After(double seconds) {
  return std::chrono::system_clock::now() + std::chrono::milliseconds(static_cast<int64_t>(seconds * 1000));
}

absl::Status Unreachable(const Session& session, absl::string_view reason) {
  return FromRpc(grpc::Status(grpc::StatusCode::UNAVAILABLE,
                              absl::StrCat("cannot reach deltarayd at ", session.server, ": ", reason)));
}

}  // namespace

Connection::Connection(const Session& session, std::shared_ptr<grpc::Channel> channel)
    : session_(&session), meshes_(v1::MeshService::NewStub(channel)), rays_(v1::RayService::NewStub(channel)) {}

absl::StatusOr<Connection> Connection::Open(const Session& session) {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(kMaxMessageBytes);
  arguments.SetUserAgentPrefix("deltaray");
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, kKeepaliveMs);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, kKeepaliveTimeoutMs);
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  // Without this, connections of one process to one server would share a socket, and gRPC serves that by one thread.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  auto channel = grpc::CreateCustomChannel(session.server, grpc::InsecureChannelCredentials(), arguments);

  // Connect before the first RPC, so that "nobody is there" is told apart from an UNAVAILABLE that a server answers.
  const auto deadline = After(session.timeout_seconds);
  while (true) {
    const grpc_connectivity_state state = channel->GetState(/*try_to_connect=*/true);
    if (state == GRPC_CHANNEL_READY) break;
    if (state == GRPC_CHANNEL_TRANSIENT_FAILURE) return Unreachable(session, "no server answers there");
    if (session.stop.fired()) return Interrupted();
    const auto now = std::chrono::system_clock::now();
    if (now >= deadline) return Unreachable(session, absl::StrCat("no answer within ", session.timeout_seconds, " s"));
    channel->WaitForStateChange(state, std::min(deadline, now + kPollInterval));
  }
  return Connection(session, std::move(channel));
}

absl::Status Connection::Call(absl::FunctionRef<grpc::Status(grpc::ClientContext*)> call) {
  grpc::ClientContext context;
  context.set_deadline(After(session_->timeout_seconds));
  const StopSignal::Scope scope(session_->stop, context);
  const grpc::Status status = call(&context);
  if (status.error_code() != grpc::StatusCode::DEADLINE_EXCEEDED) return Result(status, context);
  return FromRpc(grpc::Status(status.error_code(),
                              absl::StrCat("no answer within ", session_->timeout_seconds, " s; see --timeout")));
}

absl::Status Connection::Result(const grpc::Status& status, const grpc::ClientContext& context) {
  if (status.error_code() == grpc::StatusCode::CANCELLED && stop().fired()) return Interrupted();
  return FromRpc(status, context);
}

}  // namespace deltaray
