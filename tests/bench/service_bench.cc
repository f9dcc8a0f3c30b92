#include "tests/bench/service_bench.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <iostream>
#include <memory>
#include <thread>
#include <utility>

#include "absl/strings/str_format.h"
#include "tests/bench/kernel_run.h"
#include "tests/bench/loopback.h"
#include "tests/bench/measure.h"
#include "tests/bench/ray_sets.h"
#include "tests/bench/server_process.h"
#include "tests/bench/service_client.h"

namespace deltaray {
namespace {

// Fewer rays than this are sent several times over, so that the start of a stream does not count.
constexpr size_t kLeastRays = 1 << 20;

// Collects the lines of the CSV file.
class Lines {
 public:
  void Add(const std::string& experiment, const std::string& scene, const std::string& rays, uint32_t streams,
           size_t batch, const std::string& quantity, double value, double spread) {
    lines_.push_back(absl::StrFormat("%s,%s,%s,%d,%d,%s,%.4f,%.3f", experiment, scene, rays, streams, batch, quantity,
                                     value, spread));
    std::cerr << lines_.back() << '\n';
  }
  void Add(const std::string& experiment, const std::string& scene, const std::string& rays, uint32_t streams,
           size_t batch, const std::string& quantity, const Samples& samples) {
    Add(experiment, scene, rays, streams, batch, quantity, samples.median(), samples.spread());
  }
  const std::vector<std::string>& lines() const { return lines_; }

 private:
  std::vector<std::string> lines_ = {"experiment,scene,rays,streams,batch,quantity,value,spread"};
};

// A set of rays on a mesh that the server holds, and the same in-process.
struct Target {
  std::string scene;
  std::string mesh_id;
  const RaySet* set;
  WireRays wire;
  std::unique_ptr<Kernel> kernel;
  std::vector<float> t;    // the right answers
  size_t reply_ray_bytes;  // of a large reply

  // Whether a reply for `count` rays from `first` on is right, to the bit.
  absl::Status Check(size_t first, size_t count, const v1::HitBatch& hits) const {
    const bool same = hits.ray_count() == count && hits.t().size() == count * sizeof(float) &&
                      std::memcmp(hits.t().data(), &t[first], hits.t().size()) == 0;
    return same ? absl::OkStatus() : absl::InternalError("the service answers otherwise");
  }
};

// A server, and how it is reached.
struct Served {
  std::unique_ptr<ServerProcess> process;
  std::string ca_file;  // empty: in plaintext

  absl::StatusOr<std::unique_ptr<BenchConnection>> Connect() const {
    return BenchConnection::Open(process->address(), ca_file);
  }
};

// One server, number of streams and size of batch. Each stream has a connection of its own, which stands before the
// clock runs.
struct Load {
  const Served* from;
  std::vector<std::unique_ptr<BenchConnection>> connections;
  uint32_t batch = 0;
  Samples mrays_s, server, client, beyond, loopback;  // all but the first: processor seconds per million rays
};

// Sends all rays of the target `passes` times over, each connection a part of them.
absl::Status SendAll(const Target& target, const Load& load, uint32_t passes) {
  const size_t rays = target.set->rays.size();
  const size_t streams = load.connections.size();
  std::vector<absl::Status> statuses(streams);
  const auto send = [&](size_t i) {
    const size_t first = rays * i / streams, last = rays * (i + 1) / streams;
    for (uint32_t pass = 0; pass < passes && statuses[i].ok(); ++pass) {
      statuses[i] = StreamAll(
          **load.connections[i], target.mesh_id, target.wire, first, last - first, load.batch,
          [&target](size_t at, const v1::HitBatch& hits) { return target.Check(at, hits.ray_count(), hits); });
    }
  };
  std::vector<std::thread> threads;
  for (size_t i = 0; i < streams; ++i) threads.emplace_back(send, i);
  for (std::thread& thread : threads) thread.join();
  for (absl::Status& status : statuses) {
    if (!status.ok()) return std::move(status);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<Load>> MakeLoads(const std::vector<Served>& servers, const ServiceBenchOptions& options) {
  std::vector<Load> loads;
  for (const uint32_t streams : options.streams) {
    for (const uint32_t batch : options.batches) {
      for (const Served& server : servers) {
        Load& load = loads.emplace_back();
        load.from = &server;
        load.batch = batch;
        for (uint32_t i = 0; i < streams; ++i) {
          auto connection = server.Connect();
          if (!connection.ok()) return connection.status();
          load.connections.push_back(*std::move(connection));
        }
      }
    }
  }
  return loads;
}

// Throughput, and what it costs either side, against the same rays in-process.
absl::Status MeasureThroughput(const std::vector<Served>& servers, const Target& target,
                               const ServiceBenchOptions& options, Lines* lines) {
  absl::StatusOr<std::vector<Load>> loads = MakeLoads(servers, options);
  if (!loads.ok()) return loads.status();
  const size_t rays = target.set->rays.size();
  if (rays == 0) return absl::OkStatus();
  const auto passes = static_cast<uint32_t>((kLeastRays + rays - 1) / rays);
  const double mrays = 1e-6 * static_cast<double>(rays) * passes;
  const uint32_t cores = std::thread::hardware_concurrency();
  Samples kernel_cpu;
  std::vector<Hit> hits(rays);
  const absl::Status status = Interleave(loads->size(), options.rounds, [&](size_t i) {
    Load& load = (*loads)[i];
    const double kernel =
        1e6 / static_cast<double>(rays) * TraceAll(*target.kernel, target.set->rays, cores, kChunk, hits);
    const ServerProcess& server = *load.from->process;
    const double server_start = server.CpuSeconds();
    BuildCost cost;
    const Stopwatch stopwatch;
    if (absl::Status sent = SendAll(target, load, passes); !sent.ok()) return sent;
    stopwatch.Stop(&cost);
    const double server_cpu = (server.CpuSeconds() - server_start) / mrays;
    const double client_cpu = cost.cpu_seconds / mrays;
    const size_t batches = (kLeastRays + load.batch - 1) / load.batch;
    const absl::StatusOr<double> moved =
        MoveOverLoopback(load.batch * target.wire.ray_bytes, load.batch * target.reply_ray_bytes, batches);
    if (!moved.ok()) return moved.status();
    kernel_cpu.Add(kernel);
    load.mrays_s.Add(mrays / cost.seconds);
    load.server.Add(server_cpu);
    load.client.Add(client_cpu);
    load.beyond.Add(server_cpu + client_cpu - kernel);
    load.loopback.Add(1e6 * *moved / static_cast<double>(batches * load.batch));
    return absl::OkStatus();
  });
  if (!status.ok()) return status;
  const std::string& set = target.set->name;
  lines->Add("throughput", target.scene, set, 0, kChunk, "kernel_cpu_s_per_mray", kernel_cpu);
  for (const Load& load : *loads) {
    const auto add = [&](const char* quantity, const Samples& samples) {
      const auto streams = static_cast<uint32_t>(load.connections.size());
      lines->Add(load.from->ca_file.empty() ? "throughput" : "throughput_tls", target.scene, set, streams, load.batch,
                 quantity, samples);
    };
    add("mrays_s", load.mrays_s);
    add("server_cpu_s_per_mray", load.server);
    add("client_cpu_s_per_mray", load.client);
    add("beyond_kernel_cpu_s_per_mray", load.beyond);
    add("loopback_cpu_s_per_mray", load.loopback);
  }
  return absl::OkStatus();
}

// How long single calls take, one at a time.
absl::Status MeasureLatency(Connection& connection, const Target& target, const ServiceBenchOptions& options,
                            Lines* lines) {
  for (const bool stream : {false, true}) {
    for (const size_t rays : {size_t{1}, size_t{64}}) {
      const absl::StatusOr<Samples> samples = (stream ? StreamLatencies : UnaryLatencies)(
          connection, target.mesh_id, target.wire, rays, options.calls,
          [&](size_t first, const v1::HitBatch& hits) { return target.Check(first, rays, hits); });
      if (!samples.ok()) return samples.status();
      for (const auto& [quantity, q] : {std::pair("p50_us", 0.5), std::pair("p99_us", 0.99)}) {
        lines->Add(stream ? "stream_latency" : "unary_latency", target.scene, target.set->name, stream ? 1 : 0, rays,
                   quantity, samples->Quantile(q), samples->spread());
      }
    }
  }
  return absl::OkStatus();
}

// How long after its last byte a mesh is answered from, and how long until its final tree is.
absl::Status MeasureUpload(Connection& connection, const Scene& scene, const ServiceBenchOptions& options,
                           Lines* lines) {
  const WireRays ray(std::vector<Ray>{{.origin = {0, 0, 0}, .direction = {0, 0, 1}}});
  Samples stored, first_ray, final_tree, ratio;
  for (uint32_t round = 0; round < options.rounds; ++round) {
    std::chrono::steady_clock::time_point start;
    const auto seconds = [&start] {
      return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    };
    const absl::StatusOr<std::string> mesh =
        UploadArrays(connection, *scene.mesh, [&start] { start = std::chrono::steady_clock::now(); });
    if (!mesh.ok()) return mesh.status();
    stored.Add(seconds());
    const auto early = Cast(connection, *mesh, ray, 0, 1, v1::BUILD_WAIT_PROVISIONAL);
    if (!early.ok()) return early.status();
    const double first = seconds();
    const auto late = Cast(connection, *mesh, ray, 0, 1, v1::BUILD_WAIT_FINAL);
    if (!late.ok()) return late.status();
    const double last = seconds();
    if (early->hits().t() != late->hits().t()) return absl::InternalError("the final tree answers otherwise");
    first_ray.Add(first);
    final_tree.Add(last);
    ratio.Add(first / last);
    if (absl::Status status = DeleteMesh(connection, *mesh); !status.ok()) return status;
  }
  lines->Add("upload", scene.name, "", 0, 1, "stored_s", stored);
  lines->Add("upload", scene.name, "", 0, 1, "first_ray_s", first_ray);
  lines->Add("upload", scene.name, "", 0, 1, "final_tree_s", final_tree);
  lines->Add("upload", scene.name, "", 0, 1, "first_ray_to_final_tree", ratio);
  return absl::OkStatus();
}

// Has the server hold a mesh with its final tree; returns the mesh's id.
absl::StatusOr<std::string> Serve(Connection& connection, const TriangleMesh& mesh) {
  const absl::StatusOr<std::string> mesh_id = UploadArrays(connection, mesh, [] {});
  if (!mesh_id.ok()) return mesh_id.status();
  if (auto reply = Cast(connection, *mesh_id, WireRays({}), 0, 0, v1::BUILD_WAIT_FINAL); !reply.ok())
    return reply.status();
  return mesh_id;
}

// `connection`: to the first server.
absl::Status MeasureScene(const std::vector<Served>& servers, Connection& connection, const Scene& scene,
                          const ServiceBenchOptions& options, Lines* lines) {
  const absl::StatusOr<FinishedBuild> build = BuildOnce(scene.mesh, Config(), 0);
  if (!build.ok()) return build.status();
  absl::StatusOr<std::string> mesh_id;
  for (const Served& server : servers) {
    const auto own = server.Connect();
    if (!own.ok()) return own.status();
    mesh_id = Serve(***own, *scene.mesh);
    if (!mesh_id.ok()) return mesh_id.status();
  }
  for (const std::string& name : options.rays) {
    const Tree& tree = *build->snapshot->tree;
    const absl::StatusOr<RaySet> set = MakeRaySet(name, *scene.mesh, tree, options.size);
    if (!set.ok()) return set.status();
    WireRays wire(set->rays);
    const size_t count = std::min<size_t>(set->rays.size(), kChunk);
    const auto reply = Cast(connection, *mesh_id, wire, 0, count, v1::BUILD_WAIT_FINAL);
    if (!reply.ok()) return reply.status();
    Target target{scene.name,
                  *mesh_id,
                  &*set,
                  std::move(wire),
                  MakeDeltarayKernel(tree, {}, Question::kClosestHit),
                  std::vector<float>(set->rays.size()),
                  count == 0 ? 0 : reply->hits().ByteSizeLong() / count};
    std::vector<Hit> hits(set->rays.size());
    TraceAll(*target.kernel, set->rays, 1, kChunk, hits);
    std::ranges::transform(hits, target.t.begin(), &Hit::t);
    if (absl::Status status = MeasureThroughput(servers, target, options, lines); !status.ok()) return status;
    if (absl::Status status = MeasureLatency(connection, target, options, lines); !status.ok()) return status;
  }
  return absl::OkStatus();
}

// In plaintext, and where there are certificates by TLS.
absl::StatusOr<std::vector<Served>> StartServers(const ServiceBenchOptions& options) {
  std::vector<Served> servers;
  const std::string& directory = options.certificates;
  for (const bool tls : {false, true}) {
    if (tls && directory.empty()) break;
    std::vector<std::string> flags;
    if (tls) flags = {"--tls-cert", directory + "/server.pem", "--tls-key", directory + "/server.key"};
    absl::StatusOr<std::unique_ptr<ServerProcess>> process = ServerProcess::Start(options.server, "", flags);
    if (!process.ok()) return process.status();
    servers.push_back({*std::move(process), tls ? directory + "/ca.pem" : ""});
  }
  return servers;
}

}  // namespace

absl::Status RunServiceBench(const ServiceBenchOptions& options) {
  const absl::StatusOr<std::vector<Scene>> scenes = LoadScenes(options.scenes);
  if (!scenes.ok()) return scenes.status();
  const absl::StatusOr<std::vector<Served>> servers = StartServers(options);
  if (!servers.ok()) return servers.status();
  const absl::StatusOr<std::unique_ptr<BenchConnection>> connection = servers->front().Connect();
  if (!connection.ok()) return connection.status();
  Lines lines;
  if (!options.upload_scene.empty()) {
    const absl::StatusOr<std::vector<Scene>> upload = LoadScenes({options.upload_scene});
    if (!upload.ok()) return upload.status();
    absl::Status status = MeasureUpload(***connection, upload->front(), options, &lines);
    if (!status.ok()) return status;
  }
  for (const Scene& scene : *scenes) {
    absl::Status status = MeasureScene(*servers, ***connection, scene, options, &lines);
    if (!status.ok()) return status;
  }
  for (const Served& served : *servers) {
    if (absl::Status status = served.process->Stop(); !status.ok()) return status;
  }
  return WriteLines(options.csv, lines.lines());
}

}  // namespace deltaray
