// A world whose only triangle is the plane z = 0, primitive 7.

#ifndef TESTS_UNIT_CLIENT_FAKE_RAY_SERVICE_H_
#define TESTS_UNIT_CLIENT_FAKE_RAY_SERVICE_H_

#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "deltaray/v1/ray_service.grpc.pb.h"
#include "tests/unit/client/fake_behaviour.h"

namespace deltaray {

// What it saw is to be read after a call.
class FakeRayService : public v1::RayService::Service {
 public:
  FakeBehaviour* behaviour;
  std::mutex mutex;
  std::vector<v1::StreamStart> starts;  // of all streams
  std::multimap<std::string, std::string> last_metadata;
  v1::StreamStart last_start;
  std::vector<size_t> last_batch_bytes;
  std::string last_excluded;
  v1::CompareAccuracyRequest last_comparison;

  grpc::Status CastRays(grpc::ServerContext*, const v1::CastRaysRequest* request,
                        v1::CastRaysResponse* response) override {
    const std::lock_guard lock(mutex);
    last_start.set_mesh(request->mesh());
    *last_start.mutable_query() = request->query();
    Answer(request->rays(), response->mutable_hits());
    return grpc::Status::OK;
  }

  // Made up: FAST takes 100 ns and is wrong 3 times, WATERTIGHT 150 ns and once, EXACT 180 ns.
  grpc::Status CompareAccuracy(grpc::ServerContext*, const v1::CompareAccuracyRequest* request,
                               v1::CompareAccuracyResponse* response) override {
    const std::lock_guard lock(mutex);
    last_comparison = *request;
    last_start.clear_query();
    *last_start.mutable_query() = request->query();
    response->set_mesh_id(request->mesh());
    response->set_ray_count(request->rays().rays().size() / RayBytes());
    response->set_hit_count(response->ray_count() / 2);
    response->set_node_bytes(3 << 20);
    for (const auto level : {v1::ACCURACY_LEVEL_FAST, v1::ACCURACY_LEVEL_WATERTIGHT, v1::ACCURACY_LEVEL_EXACT}) {
      v1::AccuracyMeasurement* measurement = response->add_levels();
      measurement->set_accuracy(level);
      measurement->set_answered_accuracy(level);
    }
    response->mutable_levels(0)->set_nanoseconds_per_ray(100);
    response->mutable_levels(0)->set_false_misses(2);
    response->mutable_levels(0)->set_false_hits(1);
    response->mutable_levels(0)->set_t_error_ulp_max(12345);
    response->mutable_levels(1)->set_nanoseconds_per_ray(150);
    response->mutable_levels(1)->set_wrong_primitives(1);
    response->mutable_levels(2)->set_nanoseconds_per_ray(180);
    return grpc::Status::OK;
  }

  grpc::Status StreamRays(grpc::ServerContext* context,
                          grpc::ServerReaderWriter<v1::StreamRaysResponse, v1::StreamRaysRequest>* stream) override {
    v1::StreamRaysRequest request;
    if (!stream->Read(&request) || !request.has_start()) {
      return grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "start is missing");
    }
    const std::lock_guard lock(mutex);
    last_start = request.start();
    starts.push_back(last_start);
    last_metadata.clear();
    for (const auto& [key, value] : context->client_metadata()) {
      last_metadata.emplace(std::string(key.data(), key.size()), std::string(value.data(), value.size()));
    }
    const bool moved = starts.size() > 1 && !behaviour->moved_mesh.empty();
    last_batch_bytes.clear();
    last_excluded.clear();
    if (last_start.mesh() == "missing") return grpc::Status(grpc::StatusCode::NOT_FOUND, "no such mesh: missing");
    uint64_t batches = 0;
    grpc::Status status;
    while (true) {
      if (batches == behaviour->fail_at_batch && behaviour->stream_failures-- > 0) {
        status = behaviour->stream_status;
        break;
      }
      if (!stream->Read(&request)) break;
      last_batch_bytes.push_back(request.rays().rays().size());
      last_excluded += request.rays().excluded_primitive_ids();
      v1::StreamRaysResponse response;
      response.set_batch_number(behaviour->first_batch_number + batches);
      response.set_mesh_id(moved ? behaviour->moved_mesh : IdOf(last_start.mesh()));
      Answer(request.rays(), response.mutable_hits());
      ++batches;
      stream->Write(response);
    }
    context->AddTrailingMetadata("deltaray-batches", std::to_string(batches + behaviour->extra_batches));
    return status;
  }

 private:
  static std::string IdOf(const std::string& mesh) { return mesh.rfind("id of ", 0) == 0 ? mesh : "id of " + mesh; }

  template <typename T>
  static void Append(std::string* bytes, T value) {
    bytes->append(reinterpret_cast<const char*>(&value), sizeof(value));
  }

  // The coordinate `index` of ray `ray`, in any of the layouts.
  double Coordinate(const std::string& rays, size_t ray, size_t index) const {
    const v1::RayLayout layout = last_start.query().layout();
    const size_t columns = layout == v1::RAY_LAYOUT_FLOAT32X8 || layout == v1::RAY_LAYOUT_FLOAT64X8 ? 8 : 6;
    if (layout == v1::RAY_LAYOUT_FLOAT64X6 || layout == v1::RAY_LAYOUT_FLOAT64X8) {
      double value;
      std::memcpy(&value, rays.data() + (ray * columns + index) * sizeof(value), sizeof(value));
      return value;
    }
    float value;
    std::memcpy(&value, rays.data() + (ray * columns + index) * sizeof(value), sizeof(value));
    return value;
  }

  size_t RayBytes() const {
    switch (last_start.query().layout()) {
      case v1::RAY_LAYOUT_FLOAT32X8:
        return 32;
      case v1::RAY_LAYOUT_FLOAT64X6:
        return 48;
      case v1::RAY_LAYOUT_FLOAT64X8:
        return 64;
      default:
        return 24;
    }
  }

  void Answer(const v1::RayBatch& batch, v1::HitBatch* hits) const {
    const size_t count = batch.rays().size() / RayBytes();
    hits->set_ray_count(count);
    const v1::QueryKind kind = last_start.query().kind();
    uint32_t rows = 0;
    if (kind == v1::QUERY_KIND_ALL_HITS) Append(hits->mutable_offsets(), rows);
    for (size_t i = 0; i < count; ++i) {
      const double t = -Coordinate(batch.rays(), i, 2) / Coordinate(batch.rays(), i, 5);
      const bool hit = std::isfinite(t) && t >= 0;
      if (kind == v1::QUERY_KIND_COUNT_HITS) {
        Append<uint32_t>(hits->mutable_count(), hit);
        continue;
      }
      if (kind == v1::QUERY_KIND_ALL_HITS) {
        rows += hit;
        Append(hits->mutable_offsets(), rows);
        if (!hit) continue;
      }
      AppendRow(hit, static_cast<float>(t), hits);
    }
  }

  void AppendRow(bool hit, float t, v1::HitBatch* hits) const {
    for (const int column : last_start.query().columns()) {
      switch (column) {
        case v1::HIT_COLUMN_T:
          Append<float>(hits->mutable_t(), hit ? t : std::numeric_limits<float>::infinity());
          break;
        case v1::HIT_COLUMN_PRIMITIVE_ID:
          Append<uint32_t>(hits->mutable_primitive_id(), hit ? 7 : 0xFFFFFFFF);
          break;
        case v1::HIT_COLUMN_FACE_ID:
          Append<uint32_t>(hits->mutable_face_id(), hit ? 5 : 0xFFFFFFFF);
          break;
        case v1::HIT_COLUMN_GROUP_ID:
          Append<uint32_t>(hits->mutable_group_id(), 0xFFFFFFFF);
          break;
        case v1::HIT_COLUMN_UV:
          Append<float>(hits->mutable_uv(), hit ? 0.25f : 0);
          Append<float>(hits->mutable_uv(), hit ? 0.1f : 0);
          break;
        case v1::HIT_COLUMN_NORMAL:
          Append<float>(hits->mutable_normal(), 0);
          Append<float>(hits->mutable_normal(), 0);
          Append<float>(hits->mutable_normal(), hit ? 1 : 0);
          break;
        case v1::HIT_COLUMN_FLAGS:
          Append<uint8_t>(hits->mutable_flags(), hit ? 1 : 0);
          break;
        default:
          break;
      }
    }
  }
};

}  // namespace deltaray

#endif  // TESTS_UNIT_CLIENT_FAKE_RAY_SERVICE_H_
