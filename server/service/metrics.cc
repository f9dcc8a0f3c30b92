#include "server/service/metrics.h"

#include <algorithm>
#include <chrono>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "deltaray/v1/mesh_service.pb.h"
#include "google/protobuf/descriptor.h"

namespace deltaray {
namespace {

using prometheus::Counter;
using prometheus::Family;
using prometheus::Gauge;
using prometheus::Histogram;
using prometheus::Labels;

// From a small batch in a cache to a call that waits for a large build.
const Histogram::BucketBoundaries kCallSeconds{0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100};
const Histogram::BucketBoundaries kBatchSeconds{0.00003, 0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10};
const Histogram::BucketBoundaries kBuildSeconds{0.001, 0.01, 0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000};

constexpr const char* kCodeNames[] = {
    "OK",        "CANCELLED",      "UNKNOWN",           "INVALID_ARGUMENT",   "DEADLINE_EXCEEDED",
    "NOT_FOUND", "ALREADY_EXISTS", "PERMISSION_DENIED", "RESOURCE_EXHAUSTED", "FAILED_PRECONDITION",
    "ABORTED",   "OUT_OF_RANGE",   "UNIMPLEMENTED",     "INTERNAL",           "UNAVAILABLE",
    "DATA_LOSS", "UNAUTHENTICATED"};
constexpr const char* kLevelNames[] = {"fast", "watertight", "exact"};
constexpr const char* kPhaseNames[] = {"queued", "references", "top", "delta_leaves", "layout", "done"};

Family<Counter>& AddCounter(prometheus::Registry& registry, const char* name, const char* help) {
  return prometheus::BuildCounter().Name(name).Help(help).Register(registry);
}

Family<Gauge>& AddGauge(prometheus::Registry& registry, const char* name, const char* help) {
  return prometheus::BuildGauge().Name(name).Help(help).Register(registry);
}

Family<Histogram>& AddHistogram(prometheus::Registry& registry, const char* name, const char* help) {
  return prometheus::BuildHistogram().Name(name).Help(help).Register(registry);
}

// "closest_hit" of QUERY_KIND_CLOSEST_HIT.
std::string KindName(int kind) {
  absl::string_view name = v1::QueryKind_Name(static_cast<v1::QueryKind>(kind));
  absl::ConsumePrefix(&name, "QUERY_KIND_");
  return absl::AsciiStrToLower(name);
}

size_t CodeIndex(const absl::Status& status) {
  return std::min(static_cast<size_t>(status.raw_code()), std::size(kCodeNames) - 1);
}

}  // namespace

Metrics::Metrics() : meshes_(*registry_) {
  static_assert(std::size(kCodeNames) == kCodes && std::size(kLevelNames) == kLevels &&
                std::size(kPhaseNames) == kPhases);
  AddGauge(*registry_, "deltaray_build_info", "1, with the version of the program.")
      .Add({{"version", DELTARAY_VERSION}})
      .Set(1);
  call_seconds_ = &AddHistogram(*registry_, "deltaray_call_duration_seconds",
                                "From the beginning of a call to its end; of a stream, all of it.");
  AddMethods(*v1::UploadMeshRequest::descriptor()->file());
  AddMethods(*v1::CastRaysRequest::descriptor()->file());
  AddBatches();
  AddBuilds();
  upload_bytes_ = &AddCounter(*registry_, "deltaray_upload_bytes_total", "Bytes of files received.").Add({});
  watchdog_failures_ = &AddCounter(*registry_, "deltaray_watchdog_failures_total",
                                   "Times that the watchdog saw that the server did not accept, or not answer.")
                            .Add({});
}

void Metrics::AddMethods(const google::protobuf::FileDescriptor& file) {
  Family<Gauge>& under_way = AddGauge(*registry_, "deltaray_calls_under_way", "Calls that have begun and not ended.");
  Family<Counter>& calls = AddCounter(*registry_, "deltaray_calls_total", "Calls that have ended.");
  for (int s = 0; s < file.service_count(); ++s) {
    for (int m = 0; m < file.service(s)->method_count(); ++m) {
      const std::string name = absl::StrCat(file.service(s)->name(), "/", file.service(s)->method(m)->name());
      Method& method = methods_[name];
      method.under_way = &under_way.Add({{"method", name}});
      for (size_t code = 0; code < kCodes; ++code) {
        method.calls[code] = &calls.Add({{"method", name}, {"code", kCodeNames[code]}});
      }
    }
  }
}

Histogram& Metrics::CallSeconds(const std::string& name, Method& method, size_t code) {
  Histogram* seconds = method.seconds[code].load(std::memory_order_acquire);
  if (seconds == nullptr) {
    seconds = &call_seconds_->Add({{"method", name}, {"code", kCodeNames[code]}}, kCallSeconds);
    method.seconds[code].store(seconds, std::memory_order_release);
  }
  return *seconds;
}

void Metrics::AddBatches() {
  Family<Counter>& batches = AddCounter(*registry_, "deltaray_batches_total", "Batches of rays answered.");
  Family<Counter>& rays = AddCounter(*registry_, "deltaray_rays_total", "Rays answered.");
  Family<Counter>& hits = AddCounter(*registry_, "deltaray_hits_total",
                                     "Hits found: rays that hit, of all_hits and count_hits the triangles hit.");
  Family<Histogram>& seconds =
      AddHistogram(*registry_, "deltaray_batch_duration_seconds", "From the arrival of a batch to its reply.");
  for (size_t kind = 0; kind < kKinds; ++kind) {
    for (size_t level = 0; level < kLevels; ++level) {
      const Labels labels{{"kind", KindName(static_cast<int>(kind + 1))}, {"level", kLevelNames[level]}};
      batches_[kind][level] = {&batches.Add(labels), &rays.Add(labels), &hits.Add(labels),
                               &seconds.Add(labels, kBatchSeconds)};
    }
  }
  batches_waiting_ =
      &AddGauge(*registry_, "deltaray_batches_waiting", "Batches received that no thread traces yet.").Add({});
  batches_tracing_ = &AddGauge(*registry_, "deltaray_batches_tracing", "Batches being traced.").Add({});
}

void Metrics::AddBuilds() {
  Family<Counter>& builds = AddCounter(*registry_, "deltaray_builds_total", "Builds that have ended.");
  for (const char* outcome : {"done", "cancelled", "failed"}) builds_[outcome] = &builds.Add({{"outcome", outcome}});
  Family<Counter>& phases =
      AddCounter(*registry_, "deltaray_build_phase_seconds_total", "Seconds that builds have spent in each phase.");
  for (size_t i = 0; i < kPhases; ++i) phase_seconds_[i] = &phases.Add({{"phase", kPhaseNames[i]}});
  build_seconds_ = &AddHistogram(*registry_, "deltaray_build_duration_seconds",
                                 "Builds that were done, from their turn in the queue to the final tree.")
                        .Add({}, kBuildSeconds);
  delta_leaves_ = &AddCounter(*registry_, "deltaray_delta_leaves_built_total",
                              "Delta-leaves that were built by the end of their build; a lazy build's come later.")
                       .Add({});
}

absl::Status Metrics::OnBegin(RpcInfo& rpc) {
  if (const auto method = methods_.find(rpc.method); method != methods_.end()) method->second.under_way->Increment();
  return absl::OkStatus();
}

void Metrics::OnEnd(const RpcInfo& rpc, const absl::Status& status) {
  const auto method = methods_.find(rpc.method);
  if (method == methods_.end()) return;
  method->second.under_way->Decrement();
  const size_t code = CodeIndex(status);
  method->second.calls[code]->Increment();
  CallSeconds(method->first, method->second, code)
      .Observe(std::chrono::duration<double>(std::chrono::steady_clock::now() - rpc.began).count());
}

void Metrics::CountBatch(const AnsweredBatch& batch) {
  const BatchSeries& series = batches_[static_cast<size_t>(batch.kind) - 1][static_cast<size_t>(batch.level) - 1];
  series.batches->Increment();
  series.rays->Increment(static_cast<double>(batch.rays));
  series.hits->Increment(static_cast<double>(batch.hits));
  series.seconds->Observe(batch.seconds);
  meshes_.CountBatch(batch.mesh_id, batch.rays, batch.hits);
}

void Metrics::CountBuild(const EndedBuild& build) {
  const char* const outcome = build.status.ok() ? "done" : absl::IsCancelled(build.status) ? "cancelled" : "failed";
  builds_.find(outcome)->second->Increment();
  for (const PhaseTime& phase : build.phases) {
    phase_seconds_[static_cast<size_t>(phase.phase)]->Increment(phase.wall_seconds);
  }
  delta_leaves_->Increment(static_cast<double>(build.delta_leaves_built));
  if (build.status.ok()) build_seconds_->Observe(build.seconds);
}

void BatchMeter::BeginTracing() {
  gauge().Decrement();
  tracing_ = true;
  gauge().Increment();
}

void BatchMeter::CountAnswer(AnsweredBatch batch) {
  batch.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - began_).count();
  metrics_->CountBatch(batch);
  call_->batches.fetch_add(1, std::memory_order_relaxed);
  call_->rays.fetch_add(batch.rays, std::memory_order_relaxed);
}

}  // namespace deltaray
