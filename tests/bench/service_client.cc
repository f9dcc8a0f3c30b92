#include "tests/bench/service_client.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <limits>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/exit_code.h"
#include "client/ray_stream.h"

namespace deltaray {
namespace {

constexpr size_t kChunkBytes = 1 << 20;

double MicrosecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start).count();
}

// Sends `bytes` in chunks. False: the server has ended the call.
bool WriteChunks(grpc::ClientWriter<v1::UploadMeshRequest>& writer, std::string_view bytes) {
  v1::UploadMeshRequest request;
  for (size_t i = 0; i < bytes.size(); i += kChunkBytes) {
    const std::string_view chunk = bytes.substr(i, kChunkBytes);
    request.set_chunk(chunk.data(), chunk.size());
    if (!writer.Write(request)) return false;
  }
  return true;
}

template <typename Row>
std::string_view BytesOf(const std::vector<Row>& rows) {
  return {reinterpret_cast<const char*>(rows.data()), rows.size() * sizeof(Row)};
}

// The first ray of call number `call`: rays in turn, from the start again where they end.
size_t FirstRay(const WireRays& rays, size_t count, size_t call) { return call * count % (rays.size() - count + 1); }

v1::RayQuery Query(const WireRays& rays) {
  v1::RayQuery query;
  query.set_layout(rays.layout);
  return query;
}

}  // namespace

absl::StatusOr<std::unique_ptr<BenchConnection>> BenchConnection::Open(const std::string& address,
                                                                       const std::string& ca_file) {
  std::unique_ptr<BenchConnection> connection(new BenchConnection(address, ca_file));
  connection->connection_ = Connection::Open(connection->session_);
  if (!connection->connection_.ok()) return connection->connection_.status();
  return connection;
}

absl::StatusOr<std::string> UploadArrays(Connection& connection, const TriangleMesh& mesh,
                                         const std::function<void()>& on_last_byte, const std::string& name) {
  grpc::ClientContext context;
  v1::UploadMeshResponse response;
  const auto writer = connection.meshes().UploadMesh(&context, &response);
  v1::UploadMeshRequest request;
  v1::UploadHeader& header = *request.mutable_header();
  header.set_name(name);
  header.set_format(v1::MESH_FORMAT_RAW);
  header.mutable_raw_layout()->set_vertex_count(mesh.positions.size());
  header.mutable_raw_layout()->set_triangle_count(mesh.indices.size());
  if (writer->Write(request) && WriteChunks(*writer, BytesOf(mesh.positions)) &&
      WriteChunks(*writer, BytesOf(mesh.indices))) {
    writer->WritesDone();
  }
  on_last_byte();
  const grpc::Status status = writer->Finish();
  if (!status.ok()) return FromRpc(status);
  return response.mesh().id();
}

absl::Status DeleteMesh(Connection& connection, const std::string& mesh) {
  v1::DeleteMeshRequest request;
  request.set_mesh(mesh);
  v1::DeleteMeshResponse response;
  return connection.CallOnce(
      mesh, [&](grpc::ClientContext* context) { return connection.meshes().DeleteMesh(context, request, &response); });
}

WireRays::WireRays(std::span<const Ray> rays) {
  const bool intervals = std::any_of(rays.begin(), rays.end(), [](const Ray& ray) {
    return ray.t_min != 0 || ray.t_max != std::numeric_limits<float>::infinity();
  });
  layout = intervals ? v1::RAY_LAYOUT_FLOAT32X8 : v1::RAY_LAYOUT_FLOAT32X6;
  ray_bytes = (intervals ? 8 : 6) * sizeof(float);
  bytes.resize(rays.size() * ray_bytes);
  for (size_t i = 0; i < rays.size(); ++i) {
    const Ray& ray = rays[i];
    const float numbers[] = {ray.origin.x,    ray.origin.y,    ray.origin.z, ray.direction.x,
                             ray.direction.y, ray.direction.z, ray.t_min,    ray.t_max};
    std::memcpy(bytes.data() + i * ray_bytes, numbers, ray_bytes);
  }
}

absl::StatusOr<v1::CastRaysResponse> Cast(Connection& connection, const std::string& mesh, const WireRays& rays,
                                          size_t first, size_t count, v1::BuildWait wait) {
  v1::CastRaysRequest request;
  request.set_mesh(mesh);
  *request.mutable_query() = Query(rays);
  request.mutable_query()->set_wait(wait);
  const std::string_view bytes = rays.Some(first, count);
  request.mutable_rays()->set_rays(bytes.data(), bytes.size());
  v1::CastRaysResponse response;
  grpc::ClientContext context;
  const grpc::Status status = connection.rays().CastRays(&context, request, &response);
  if (!status.ok()) return FromRpc(status);
  return response;
}

absl::Status StreamAll(Connection& connection, const std::string& mesh, const WireRays& rays, size_t first,
                       size_t count, size_t batch, const CheckHits& check) {
  v1::StreamStart start;
  start.set_mesh(mesh);
  *start.mutable_query() = Query(rays);
  size_t sent = 0, answered = 0;
  return StreamBatches(
      connection, start,
      [&](OutgoingBatch& outgoing) -> absl::StatusOr<bool> {
        const size_t next = std::min(batch, count - sent);
        if (next == 0) return false;
        const std::string_view bytes = rays.Some(first + sent, next);
        outgoing.rays.set_rays(bytes.data(), bytes.size());
        outgoing.ray_count = static_cast<uint32_t>(next);
        sent += next;
        return true;
      },
      [&](const v1::HitBatch& hits) {
        const size_t at = first + answered;
        answered += hits.ray_count();
        return check(at, hits);
      });
}

absl::StatusOr<Samples> UnaryLatencies(Connection& connection, const std::string& mesh, const WireRays& rays,
                                       size_t count, size_t calls, const CheckHits& check) {
  Samples samples;
  for (size_t call = 0; call < calls; ++call) {
    const size_t first = FirstRay(rays, count, call);
    const auto start = std::chrono::steady_clock::now();
    const absl::StatusOr<v1::CastRaysResponse> response =
        Cast(connection, mesh, rays, first, count, v1::BUILD_WAIT_PROVISIONAL);
    if (!response.ok()) return response.status();
    samples.Add(MicrosecondsSince(start));
    if (absl::Status status = check(first, response->hits()); !status.ok()) return status;
  }
  return samples;
}

absl::StatusOr<Samples> StreamLatencies(Connection& connection, const std::string& mesh, const WireRays& rays,
                                        size_t count, size_t calls, const CheckHits& check) {
  grpc::ClientContext context;
  const auto stream = connection.rays().StreamRays(&context);
  v1::StreamRaysRequest request;
  request.mutable_start()->set_mesh(mesh);
  *request.mutable_start()->mutable_query() = Query(rays);
  stream->Write(request);
  Samples samples;
  v1::StreamRaysResponse response;
  absl::Status checked;
  size_t answered = 0;
  for (; answered < calls && checked.ok(); ++answered) {
    const size_t first = FirstRay(rays, count, answered);
    const auto start = std::chrono::steady_clock::now();
    const std::string_view bytes = rays.Some(first, count);
    request.mutable_rays()->set_rays(bytes.data(), bytes.size());
    if (!stream->Write(request) || !stream->Read(&response)) break;
    samples.Add(MicrosecondsSince(start));
    checked = check(first, response.hits());
  }
  stream->WritesDone();
  const grpc::Status status = stream->Finish();
  if (!status.ok()) return FromRpc(status);
  if (!checked.ok()) return checked;
  if (answered < calls) {
    return absl::InternalError(absl::StrCat("the stream ended after ", answered, " of ", calls, " batches"));
  }
  return samples;
}

}  // namespace deltaray
