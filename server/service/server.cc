#include "server/service/server.h"

#include <algorithm>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "grpcpp/ext/channelz_service_plugin.h"
#include "grpcpp/ext/proto_server_reflection_plugin.h"
#include "grpcpp/resource_quota.h"
#include "grpcpp/server.h"
#include "grpcpp/server_builder.h"
#include "server/geometry/float_environment.h"
#include "server/service/authenticator.h"
#include "server/service/call_log.h"
#include "server/service/calls.h"
#include "server/service/connection_guard.h"
#include "server/service/health.h"
#include "server/service/listen_address.h"
#include "server/service/listener.h"
#include "server/service/mesh_handlers.h"
#include "server/service/metrics.h"
#include "server/service/metrics_page.h"
#include "server/service/ray_handlers.h"
#include "server/service/ticker.h"
#include "server/service/tls_certificates.h"
#include "server/service/tracer.h"
#include "server/service/wake_call.h"
#include "server/service/watchdog.h"
#include "server/service/worker_pool.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr uint32_t kDiskThreads = 4;
// Changes take turns; those that wait for the lock of a server that has stopped wait at the same time.
constexpr uint32_t kChangeThreads = 4;
// Uploads that are read at once. Each takes memory for the whole mesh, and a core.
constexpr uint32_t kCommitThreads = 2;
// A client that has stopped without closing its connection is noticed by this alone.
constexpr int kKeepaliveMs = 30'000;
constexpr int kKeepaliveTimeoutMs = 10'000;
// How long a new connection may take until it speaks HTTP/2.
constexpr int kHandshakeTimeoutMs = 10'000;
// How often calls are looked at.
constexpr std::chrono::milliseconds kTick{250};
// The least time between pings of a client that has no call under way.
constexpr int kMinPingIntervalMs = 10'000;
// Reflection and channelz are gRPC's own services, each of whose calls holds a thread to its end: so many at once,
// beside the threads that wait for them.
constexpr int kMaxGrpcServiceCalls = 8;
// Once all of our calls have ended, only health watches and reflection are left.
constexpr std::chrono::milliseconds kLastCalls{200};

// How long the watchdog waits for what takes no time where all is well.
constexpr std::chrono::milliseconds kPatience{2000};

// What options.security asks for, nullptr where it does not.
struct Security {
  std::unique_ptr<TlsCertificates> certificates;
  std::unique_ptr<Authenticator> authenticator;
};

absl::StatusOr<Security> ReadSecurity(const SecurityOptions& options, const std::string& listen) {
  Security security;
  if (options.tls()) {
    absl::StatusOr<std::unique_ptr<TlsCertificates>> certificates = TlsCertificates::Start(options);
    if (!certificates.ok()) return certificates.status();
    security.certificates = *std::move(certificates);
  }
  if (!options.token_file.empty()) {
    absl::StatusOr<std::unique_ptr<Authenticator>> authenticator = Authenticator::Start(options.token_file);
    if (!authenticator.ok()) return authenticator.status();
    security.authenticator = *std::move(authenticator);
  }
  const bool shown = !options.tls_client_ca.empty();
  spdlog::info("connections are {}; {}",
               shown           ? "mutual TLS"
               : options.tls() ? "TLS"
                               : "plaintext",
               options.token_file.empty() ? "no tokens are asked for" : "tokens are asked for");
  if (IsLoopback(listen)) return security;
  if (!options.tls() && !options.token_file.empty()) {
    spdlog::warn("other machines can reach {}, and tokens travel there in plaintext", listen);
  }
  if (!shown && options.token_file.empty()) {
    spdlog::warn("whoever can reach {} may upload and delete: there is neither --token-file nor --tls-client-ca",
                 listen);
  }
  return security;
}

class GrpcServer final : public Server {
 public:
  GrpcServer(const ServerOptions& options, Security security, std::shared_ptr<Metrics> metrics,
             std::unique_ptr<MeshStore> store)
      : options_(options),
        security_(std::move(security)),
        metrics_(std::move(metrics)),
        tracer_(options.threads),
        batch_budget_(options.batch_bytes_in_force()),
        connection_guard_(options.max_connection_calls),
        call_limits_(options.calls),
        calls_(Watchers(), options.idle_timeout),
        store_(std::move(store)),
        mesh_handlers_(&calls_, {store_.get(), &disk_, &changes_, &commits_, options.store.max_upload_bytes,
                                 options.batch.max_message_bytes, &batch_budget_, metrics_.get()}),
        ray_handlers_(&calls_, {store_.get(), &disk_, &tracer_, options.batch, &batch_budget_, metrics_.get()}),
        health_handlers_(&calls_, store_.get(), &disk_, &batch_budget_),
        disk_(kDiskThreads),
        changes_(kChangeThreads),
        commits_(kCommitThreads) {}

  ~GrpcServer() override {
    if (server_ != nullptr) Shutdown(std::chrono::milliseconds(0));
    // No call is left. Tasks of calls that were cut off may be, and they use the store.
    tracer_.Stop();
  }

  absl::Status Listen() {
    absl::StatusOr<std::unique_ptr<Listener>> listener = Listener::Open(options_.listen, options_.max_connections);
    if (!listener.ok()) return listener.status();
    listener_ = *std::move(listener);
    if (!options_.metrics_listen.empty()) {
      auto page =
          MetricsPage::Serve(options_.metrics_listen, metrics_.get(), store_.get(), &batch_budget_, listener_.get());
      if (!page.ok()) return page.status();
      metrics_page_ = *std::move(page);
    }
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    if (options_.channelz) grpc::channelz::experimental::InitChannelzService();
    grpc::ServerBuilder builder;
    auto acceptor = builder.experimental().AddExternalConnectionAcceptor(
        grpc::ServerBuilder::experimental_type::ExternalConnectionType::FROM_FD,
        security_.certificates == nullptr ? grpc::InsecureServerCredentials() : security_.certificates->Credentials());
    builder.RegisterService(&mesh_handlers_);
    builder.RegisterService(&ray_handlers_);
    builder.RegisterService(&health_handlers_);
    builder.SetMaxReceiveMessageSize(static_cast<int>(options_.batch.max_message_bytes));
    // A few megabytes of gzip can grow to gigabytes, before any limit is looked at.
    builder.SetCompressionAlgorithmSupportStatus(GRPC_COMPRESS_DEFLATE, false);
    builder.SetCompressionAlgorithmSupportStatus(GRPC_COMPRESS_GZIP, false);
    // The limit on messages is looked at only once a message is in memory; this one holds before.
    grpc::ResourceQuota quota("deltarayd");
    // As many as gRPC would have: they look at all connections, and with one of them idle servers answer late.
    const int waiting_threads = std::max(2, static_cast<int>(std::thread::hardware_concurrency()));
    builder.SetResourceQuota(
        quota.Resize(options_.network_bytes_in_force()).SetMaxThreads(waiting_threads + kMaxGrpcServiceCalls));
    builder.SetSyncServerOption(grpc::ServerBuilder::NUM_CQS, waiting_threads);
    builder.SetSyncServerOption(grpc::ServerBuilder::MIN_POLLERS, 1);
    builder.SetSyncServerOption(grpc::ServerBuilder::MAX_POLLERS, 1);
    // gRPC would read megabytes ahead of us on every stream. Without it, 64 KiB until we read, and 1 MiB then.
    builder.AddChannelArgument(GRPC_ARG_HTTP2_BDP_PROBE, 0);
    builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, static_cast<int>(options_.max_connection_calls));
    builder.AddChannelArgument(GRPC_ARG_MAX_METADATA_SIZE, static_cast<int>(options_.max_metadata_bytes));
    builder.AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, kHandshakeTimeoutMs);
    builder.AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, static_cast<int>(options_.idle_timeout.count()));
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, kKeepaliveMs);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, kKeepaliveTimeoutMs);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
    builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, kMinPingIntervalMs);
    server_ = builder.BuildAndStart();
    if (server_ == nullptr) return absl::UnavailableError("gRPC cannot start a server");
    listener_->Start(std::move(acceptor));
    wake_call_.emplace(server_->InProcessChannel({}));
    ticker_.emplace(kTick, [this] {
      const auto now = std::chrono::steady_clock::now();
      calls_.Tick(now);
      batch_budget_.Tick(now);
      store_->ForgetCancelled();
      disk_.ForgetCancelled();
      changes_.ForgetCancelled();
      wake_call_->Make();
    });
    watchdog_.emplace(
        options_.watchdog_interval, [this] { return WhatIsWrong(); },
        [this] {
          metrics_->CountWatchdogFailure();
          if (absl::Status status = listener_->Rebind(); !status.ok())
            spdlog::error("watchdog: {}", std::string(status.message()));
        });
    return absl::OkStatus();
  }

  int port() const override { return listener_->port(); }
  int metrics_port() const override { return metrics_page_ == nullptr ? 0 : metrics_page_->port(); }
  uint32_t max_connections() const override { return listener_->max_connections(); }
  uint32_t threads() const override { return tracer_.threads(); }
  bool Drain() override { return Shutdown(options_.drain_timeout); }

 private:
  // In the order in which they are asked.
  std::vector<CallWatcher*> Watchers() {
    std::vector<CallWatcher*> watchers{metrics_.get(), &call_log_, &connection_guard_};
    if (security_.authenticator != nullptr) watchers.push_back(security_.authenticator.get());
    watchers.push_back(&call_limits_);
    return watchers;
  }

  // For the watchdog; empty: nothing.
  std::string WhatIsWrong() const {
    if (!listener_->Hears(kPatience)) return absl::StrCat("connections to ", listener_->address(), " are not accepted");
    if (wake_call_->Waiting() > kPatience) return "gRPC does not answer a call of our own";
    return "";
  }

  bool Shutdown(std::chrono::milliseconds timeout) {
    MutexLock lock(shutdown_mutex_);
    if (shut_down_) return true;
    shut_down_ = true;
    const auto deadline = std::chrono::steady_clock::now() + timeout;
    health_handlers_.Drain();
    calls_.Drain();
    // A build may take longer than the drain, and ends with it.
    store_->StopWaiting(DrainingError());
    const bool all_ended = calls_.WaitUntilNone(deadline);
    // Without a deadline this would wait forever for whoever watches our health.
    const auto grace = all_ended ? std::min(timeout, kLastCalls) : std::chrono::milliseconds(0);
    watchdog_.reset();
    listener_->Stop();
    // It makes calls, and looks at some.
    ticker_.reset();
    server_->Shutdown(std::chrono::system_clock::now() + grace);
    return all_ended;
  }

  const ServerOptions options_;
  const Security security_;
  const std::shared_ptr<Metrics> metrics_;  // the builds of the store count there too
  // In the order in which they must outlive each other: tasks of the pools, which outlive their calls, use handlers,
  // and all of them the store, whose builds hand answers to the tracer, as the budget's thread does with batches.
  Tracer tracer_;
  BatchBudget batch_budget_;
  CallLog call_log_;
  ConnectionGuard connection_guard_;
  CallLimits call_limits_;
  Calls calls_;
  const std::unique_ptr<MeshStore> store_;
  MeshHandlers mesh_handlers_;
  RayHandlers ray_handlers_;
  HealthHandlers health_handlers_;
  WorkerPool disk_;
  WorkerPool changes_;
  WorkerPool commits_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<Listener> listener_;
  std::unique_ptr<MetricsPage> metrics_page_;
  std::optional<WakeCall> wake_call_;
  std::optional<Ticker> ticker_;
  std::optional<Watchdog> watchdog_;
  Mutex shutdown_mutex_;
  bool shut_down_ ABSL_GUARDED_BY(shutdown_mutex_) = false;
};

absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options, std::shared_ptr<Metrics> metrics,
                                                    std::unique_ptr<MeshStore> store) {
  if (const char* const fault = FloatEnvironmentFault()) {
    return absl::FailedPreconditionError(
        absl::StrCat("floating-point arithmetic is not as IEEE 754 has it: ", fault,
                     "; a library that is preloaded, or was compiled with -ffast-math, may have set that"));
  }
  absl::StatusOr<Security> security = ReadSecurity(options.security, options.listen);
  if (!security.ok()) return security.status();
  auto server = std::make_unique<GrpcServer>(options, *std::move(security), std::move(metrics), std::move(store));
  if (absl::Status status = server->Listen(); !status.ok()) return status;
  return server;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Server>> Server::Start(const ServerOptions& options) {
  const auto metrics = std::make_shared<Metrics>();
  MeshStore::Options store_options = options.store;
  store_options.mesh_limits.max_group_bytes = options.max_group_bytes_in_force();
  store_options.on_build_end = [metrics](const EndedBuild& build) { metrics->CountBuild(build); };
  absl::StatusOr<std::unique_ptr<MeshStore>> store = MeshStore::Open(store_options);
  if (!store.ok()) return store.status();
  return StartServer(options, metrics, *std::move(store));
}

absl::StatusOr<std::unique_ptr<Server>> Server::Start(const ServerOptions& options, std::unique_ptr<MeshStore> store) {
  return StartServer(options, std::make_shared<Metrics>(), std::move(store));
}

}  // namespace deltaray
