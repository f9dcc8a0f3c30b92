#include "client/connection.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/exit_code.h"
#include "client/retry.h"
#include "client/security_flags.h"
#include "client/tls.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/support/channel_arguments.h"

namespace deltaray {
namespace {

// A server that has vanished, cable and all, is noticed after these. The server's end pings far more often; a client
// that pings more than every 5 minutes would be cut off by gRPC's default policy.
constexpr int kKeepaliveMs = 360'000;
constexpr int kKeepaliveTimeoutMs = 20'000;

// How soon, and how often at most, a connection that was lost is tried again.
constexpr int kReconnectMs = 100;
constexpr int kLongestReconnectMs = 1000;

// How long a stop of the program may go unnoticed while connecting or waiting.
constexpr std::chrono::milliseconds kPollInterval(100);

std::chrono::system_clock::time_point After(double seconds) {
  return std::chrono::system_clock::now() + std::chrono::milliseconds(static_cast<int64_t>(seconds * 1000));
}

absl::Status Unreachable(const Session& session, absl::string_view reason) {
  return FromRpc(grpc::Status(grpc::StatusCode::UNAVAILABLE,
                              absl::StrCat("cannot reach deltarayd at ", session.server, ": ", reason)));
}

// The variable of the environment that names a proxy for the session's server; empty: none. It may except the server
// (no_proxy), which only gRPC knows.
absl::string_view ProxyVariable(const Session& session) {
  if (StaysHere(session.server)) return "";
  for (const char* const name : {"grpc_proxy", "https_proxy", "http_proxy"}) {
    const char* const value = std::getenv(name);
    if (value != nullptr && *value != '\0') return name;
  }
  return "";
}

std::string NoAddress(const Session& session) {
  const absl::string_view proxy = ProxyVariable(session);
  if (proxy.empty()) return "its name cannot be resolved";
  return absl::StrCat("its name, or that of the proxy in ", proxy, ", cannot be resolved");
}

// Whether the channel, which has failed, found no address for the server's name. Only gRPC knows: with a proxy it looks
// for that one's. It tells no more than by the text of a call.
bool IsUnresolved(const std::shared_ptr<grpc::Channel>& channel) {
  grpc::ClientContext context;
  context.set_deadline(After(1));
  grpc::health::v1::HealthCheckResponse response;
  const grpc::Status status = grpc::health::v1::Health::NewStub(channel)->Check(&context, {}, &response);
  return absl::StartsWith(status.error_message(), "DNS resolution failed");
}

// Why no connection came about.
std::string Reason(const Session& session, const std::optional<Tls>& tls) {
  const std::string reason = tls.has_value()                   ? tls->WhyNot(session.server)
                             : Tls::IsSpokenBy(session.server) ? "the server there speaks TLS: see --tls and --ca"
                                                               : "";
  return reason.empty() ? "no server answers there" : reason;
}

// Metadata holds only printable ASCII.
std::string MetadataText(absl::string_view mesh) {
  std::string text;
  for (const char c : mesh) {
    if (absl::ascii_isgraph(c) && c != '%') {
      text += c;
    } else {
      absl::StrAppendFormat(&text, "%%%02X", static_cast<unsigned char>(c));
    }
  }
  return text;
}

}  // namespace

Connection::Connection(const Session& session, std::string token, std::shared_ptr<grpc::Channel> channel)
    : session_(&session),
      token_(std::move(token)),
      channel_(channel),
      meshes_(v1::MeshService::NewStub(channel)),
      rays_(v1::RayService::NewStub(channel)),
      health_(grpc::health::v1::Health::NewStub(channel)) {}

absl::StatusOr<Connection> Connection::Open(const Session& session) {
  absl::StatusOr<std::string> token = ReadToken(session.security, session.server);
  if (!token.ok()) return token.status();
  std::optional<Tls> tls;
  if (session.security.UsesTls()) {
    absl::StatusOr<Tls> read = Tls::Read(session.security);
    if (!read.ok()) return read.status();
    tls = *std::move(read);
  }
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(kMaxMessageBytes);
  arguments.SetUserAgentPrefix("deltaray");
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, kKeepaliveMs);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, kKeepaliveTimeoutMs);
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, kReconnectMs);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, kLongestReconnectMs);
  // gRPC's own retries would have to know which calls may be made twice.
  arguments.SetInt(GRPC_ARG_ENABLE_RETRIES, 0);
  // A proxy would take what is meant for this machine, tokens in plaintext too, to another one.
  if (StaysHere(session.server)) arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  // Without this, connections of one process to one server would share a socket, and gRPC serves that by one thread.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  auto channel = grpc::CreateCustomChannel(session.server,
                                           tls ? tls->Credentials() : grpc::InsecureChannelCredentials(), arguments);

  // Connect before the first RPC, so that "nobody is there" is told apart from an UNAVAILABLE that a server answers.
  const auto deadline = After(session.timeout_seconds);
  while (true) {
    const grpc_connectivity_state state = channel->GetState(/*try_to_connect=*/true);
    if (state == GRPC_CHANNEL_READY) break;
    if (state == GRPC_CHANNEL_TRANSIENT_FAILURE) {
      const bool unresolved = IsUnresolved(channel);
      // It would go on trying while the reason is looked for, and into the end of the process.
      channel.reset();
      return Unreachable(session, unresolved ? NoAddress(session) : Reason(session, tls));
    }
    if (session.stop.fired()) return Interrupted();
    const auto now = std::chrono::system_clock::now();
    if (now >= deadline) return Unreachable(session, absl::StrCat("no answer within ", session.timeout_seconds, " s"));
    channel->WaitForStateChange(state, std::min(deadline, now + kPollInterval));
  }
  return Connection(session, *std::move(token), std::move(channel));
}

void Connection::Prepare(absl::string_view mesh, grpc::ClientContext* context) const {
  if (!token_.empty()) context->AddMetadata("authorization", absl::StrCat("Bearer ", token_));
  if (!mesh.empty()) context->AddMetadata("deltaray-mesh", MetadataText(mesh));
}

grpc::Status Connection::Call(absl::string_view mesh, absl::FunctionRef<grpc::Status(grpc::ClientContext*)> call) {
  grpc::ClientContext context;
  Prepare(mesh, &context);
  context.set_deadline(After(session_->timeout_seconds));
  const StopSignal::Scope scope(session_->stop, context);
  grpc::Status status = WithRequestId(call(&context), context);
  if (status.error_code() != grpc::StatusCode::DEADLINE_EXCEEDED) return status;
  return {status.error_code(), absl::StrCat("no answer within ", session_->timeout_seconds, " s; see --timeout")};
}

absl::Status Connection::CallOnce(absl::string_view mesh, absl::FunctionRef<grpc::Status(grpc::ClientContext*)> call) {
  return Result(Call(mesh, call));
}

absl::Status Connection::CallAgain(absl::string_view mesh, absl::FunctionRef<grpc::Status(grpc::ClientContext*)> call) {
  Retry retry(*this);
  while (true) {
    const grpc::Status status = Call(mesh, call);
    if (!retry.Again(status)) return Result(status);
  }
}

void Connection::Wait(std::chrono::milliseconds time) const {
  const auto end = std::chrono::steady_clock::now() + time;
  while (!session_->stop.fired()) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
    if (left.count() <= 0) return;
    const grpc_connectivity_state state = channel_->GetState(/*try_to_connect=*/true);
    channel_->WaitForStateChange(state, std::chrono::system_clock::now() + std::min(left, kPollInterval));
  }
}

absl::Status Connection::Result(const grpc::Status& status) {
  // As 502, 503 and 504 of HTTP, in words of gRPC's own.
  if (absl::StartsWith(status.error_message(), "Received http2 header with status: 50")) {
    return FromRpc({status.error_code(), absl::StrCat(status.error_message(), "; a proxy answered at ",
                                                      session_->server, ", and no server behind it")});
  }
  if (status.error_code() != grpc::StatusCode::CANCELLED) return FromRpc(status);
  if (stop().fired()) return Interrupted();
  return FromRpc({grpc::StatusCode::UNAVAILABLE, absl::StrCat("the server ended: ", status.error_message())});
}

}  // namespace deltaray
