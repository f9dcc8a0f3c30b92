// What the server counts for Prometheus; server/README.md has names and meanings.

#ifndef SERVER_SERVICE_METRICS_H_
#define SERVER_SERVICE_METRICS_H_

#include <array>
#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "deltaray/v1/ray_service.pb.h"
#include "prometheus/counter.h"
#include "prometheus/gauge.h"
#include "prometheus/histogram.h"
#include "prometheus/registry.h"
#include "server/service/call_watcher.h"
#include "server/service/mesh_metrics.h"
#include "server/store/mesh_store.h"

namespace deltaray {

// A batch that was answered.
struct AnsweredBatch {
  std::string_view mesh_id;
  v1::QueryKind kind;
  AccuracyLevel level;
  uint64_t rays = 0;
  uint64_t hits = 0;
  double seconds = 0;  // from its arrival to its reply
};

// All counters of one server. Thread-safe. What rays pass is counted once a batch, by atomic additions and two short
// locks: some hundred nanoseconds.
class Metrics final : public CallWatcher {
 public:
  Metrics();

  // Every method of the contract has counters of all codes from the start, so that the first failure is seen as a rise;
  // histograms, which are large, once there is something in them.
  absl::Status OnBegin(RpcInfo& rpc) override;
  void OnEnd(const RpcInfo& rpc, const absl::Status& status) override;

  void CountBatch(const AnsweredBatch& batch);
  void CountUploadBytes(size_t bytes) { upload_bytes_->Increment(static_cast<double>(bytes)); }
  void CountBuild(const EndedBuild& build);
  void CountWatchdogFailure() { watchdog_failures_->Increment(); }

  prometheus::Gauge& batches_waiting() { return *batches_waiting_; }
  prometheus::Gauge& batches_tracing() { return *batches_tracing_; }
  MeshMetrics& meshes() { return meshes_; }

  // All that is counted here.
  const std::shared_ptr<prometheus::Registry>& registry() const { return registry_; }

 private:
  static constexpr size_t kCodes = 17;  // of gRPC
  static constexpr size_t kKinds = 4;   // of v1::QueryKind
  static constexpr size_t kLevels = 3;  // of AccuracyLevel
  static constexpr size_t kPhases = 6;  // of BuildPhase
  struct Method {
    prometheus::Gauge* under_way = nullptr;
    std::array<prometheus::Counter*, kCodes> calls{};
    std::array<std::atomic<prometheus::Histogram*>, kCodes> seconds{};  // nullptr: no call has ended so yet
  };
  struct BatchSeries {
    prometheus::Counter* batches = nullptr;
    prometheus::Counter* rays = nullptr;
    prometheus::Counter* hits = nullptr;
    prometheus::Histogram* seconds = nullptr;
  };

  void AddMethods(const google::protobuf::FileDescriptor& file);
  prometheus::Histogram& CallSeconds(const std::string& name, Method& method, size_t code);
  void AddBatches();
  void AddBuilds();

  const std::shared_ptr<prometheus::Registry> registry_ = std::make_shared<prometheus::Registry>();
  std::map<std::string, Method, std::less<>> methods_;  // by RpcInfo::method; no method is added once made
  prometheus::Family<prometheus::Histogram>* call_seconds_;
  std::array<std::array<BatchSeries, kLevels>, kKinds> batches_;
  prometheus::Gauge* batches_waiting_;
  prometheus::Gauge* batches_tracing_;
  prometheus::Counter* upload_bytes_;
  std::map<std::string, prometheus::Counter*, std::less<>> builds_;  // by outcome
  std::array<prometheus::Counter*, kPhases> phase_seconds_;
  prometheus::Histogram* build_seconds_;
  prometheus::Counter* delta_leaves_;
  prometheus::Counter* watchdog_failures_;
  MeshMetrics meshes_;
};

// A batch from its arrival on: waits, is traced, is answered or not. Used by one thread at a time.
class BatchMeter {
 public:
  // `call`, of the batch, outlives this.
  BatchMeter(Metrics* metrics, CallRecord* call) : metrics_(metrics), call_(call) {
    metrics_->batches_waiting().Increment();
  }
  ~BatchMeter() { gauge().Decrement(); }
  BatchMeter(const BatchMeter&) = delete;
  BatchMeter& operator=(const BatchMeter&) = delete;

  void BeginTracing();
  // Sets batch.seconds.
  void CountAnswer(AnsweredBatch batch);

 private:
  prometheus::Gauge& gauge() { return tracing_ ? metrics_->batches_tracing() : metrics_->batches_waiting(); }

  Metrics* const metrics_;
  CallRecord* const call_;
  const std::chrono::steady_clock::time_point began_ = std::chrono::steady_clock::now();
  bool tracing_ = false;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_METRICS_H_
