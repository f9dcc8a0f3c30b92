#include "tests/torture/probe.h"

#include <algorithm>
#include <chrono>
#include <functional>
#include <iostream>
#include <memory>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/exit_code.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/impl/codegen/client_unary_call.h"
#include "tests/bench/measure.h"
#include "tests/bench/service_client.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {

using std::chrono::steady_clock;

constexpr std::chrono::milliseconds kInterval(10);
constexpr int kMostTries = 30;
constexpr int kLongestPause = 10;  // in intervals
constexpr uint32_t kSpeedRays = 1 << 19;
constexpr uint32_t kSpeedBatch = 1 << 14;

// What probes are made of: a connection, a mesh, and rays through it.
struct Target {
  std::unique_ptr<BenchConnection> connection;
  std::string mesh;
  std::unique_ptr<WireRays> rays;
};

absl::StatusOr<Target> MakeTarget(const ProbeOptions& options, uint32_t rays) {
  const absl::StatusOr<std::vector<Scene>> scenes = LoadScenes({options.scene});
  if (!scenes.ok()) return scenes.status();
  absl::StatusOr<std::unique_ptr<BenchConnection>> connection = BenchConnection::Open(options.server);
  if (!connection.ok()) return connection.status();
  const absl::StatusOr<std::string> mesh = UploadArrays(***connection, *scenes->front().mesh, [] {});
  if (!mesh.ok()) return mesh.status();
  return Target{*std::move(connection), *mesh,
                std::make_unique<WireRays>(ChordRays(MeshBounds(*scenes->front().mesh), rays, 2))};
}

double Milliseconds(steady_clock::duration time) { return std::chrono::duration<double, std::milli>(time).count(); }

// Calls `call` every 10 ms until `end` and notes how long it took to an answer, and how many calls had to be made
// again: as every client has to be ready for, its connection may be closed between two calls to make room, and a new
// one too before its first call has come.
absl::Status Repeat(steady_clock::time_point end, Samples* times, int* repeated,
                    const std::function<absl::Status()>& call) {
  while (steady_clock::now() < end) {
    const auto start = steady_clock::now();
    absl::Status status = call();
    for (int tries = 1; absl::IsUnavailable(status) && tries < kMostTries; ++tries) {
      ++*repeated;
      // A new connection is not tried before gRPC's back-off is over.
      if (tries > 1) std::this_thread::sleep_for(kInterval * std::min(tries, kLongestPause));
      status = call();
    }
    if (!status.ok()) return status;
    times->Add(Milliseconds(steady_clock::now() - start));
    std::this_thread::sleep_for(kInterval);
  }
  return absl::OkStatus();
}

absl::Status CheckHealth(grpc::Channel& channel) {
  // An empty HealthCheckRequest.
  grpc::Slice empty;
  const grpc::ByteBuffer request(&empty, 1);
  grpc::ByteBuffer response;
  grpc::ClientContext context;
  return FromRpc(grpc::internal::BlockingUnaryCall<grpc::ByteBuffer, grpc::ByteBuffer>(
      &channel, grpc::internal::RpcMethod("/grpc.health.v1.Health/Check", grpc::internal::RpcMethod::NORMAL_RPC),
      &context, request, &response));
}

std::string Text(const char* name, const Samples& times) {
  return absl::StrFormat("%s p50 %.2f p99 %.2f p99.9 %.2f ms", name, times.median(), times.Quantile(0.99),
                         times.Quantile(0.999));
}

}  // namespace

absl::Status RunProbe(const ProbeOptions& options) {
  const absl::StatusOr<Target> target = MakeTarget(options, options.rays);
  if (!target.ok()) return target.status();
  const auto channel = grpc::CreateChannel(options.server, grpc::InsecureChannelCredentials());
  const auto end = steady_clock::now() + std::chrono::milliseconds(static_cast<int64_t>(options.seconds * 1000));
  Samples rays, health, wakes;
  int rays_repeated = 0, health_repeated = 0;
  absl::Status health_status;
  std::thread health_thread(
      [&] { health_status = Repeat(end, &health, &health_repeated, [&] { return CheckHealth(*channel); }); });
  std::thread wake_thread([&] {
    while (steady_clock::now() < end) {
      const auto due = steady_clock::now() + kInterval;
      std::this_thread::sleep_until(due);
      wakes.Add(Milliseconds(steady_clock::now() - due));
    }
  });
  const absl::Status rays_status = Repeat(end, &rays, &rays_repeated, [&] {
    return Cast(**target->connection, target->mesh, *target->rays, 0, options.rays, v1::BUILD_WAIT_PROVISIONAL)
        .status();
  });
  health_thread.join();
  wake_thread.join();
  if (!rays_status.ok()) return rays_status;
  if (!health_status.ok()) return health_status;
  std::cout << Text("calls", rays) << ", " << Text("health", health) << ", " << Text("own", wakes) << ", "
            << rays_repeated + health_repeated << " made again\n";
  return absl::OkStatus();
}

absl::Status RunSpeed(const ProbeOptions& options) {
  const absl::StatusOr<Target> target = MakeTarget(options, kSpeedRays);
  if (!target.ok()) return target.status();
  const auto start = steady_clock::now();
  uint64_t rays = 0;
  double seconds = 0;
  for (; seconds < options.seconds; seconds = 1e-3 * Milliseconds(steady_clock::now() - start)) {
    const absl::Status status = StreamAll(**target->connection, target->mesh, *target->rays, 0, kSpeedRays, kSpeedBatch,
                                          [&](size_t, const v1::HitBatch& hits) {
                                            rays += hits.ray_count();
                                            return absl::OkStatus();
                                          });
    if (!status.ok()) return status;
  }
  std::cout << absl::StrFormat("%.3f Mrays/s\n", 1e-6 * static_cast<double>(rays) / seconds);
  return absl::OkStatus();
}

}  // namespace deltaray
