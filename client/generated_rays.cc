#include "client/generated_rays.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "client/camera.h"
#include "client/exit_code.h"
#include "client/hit_column.h"
#include "client/vec3.h"

namespace deltaray {
namespace {

// Side of the picture whose hits kBounce and kShadow start from.
constexpr uint32_t kStartsSide = 256;

template <typename T>
void Append(const T& value, std::string* bytes) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof(value));
}

// Uniform numbers and directions: std's distributions differ from library to library.
class Random {
 public:
  explicit Random(uint64_t seed) : engine_(seed) {}

  double Unit() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  uint64_t Below(uint64_t bound) { return engine_() % bound; }
  Vec3 Direction() {
    const double z = 2 * Unit() - 1;
    const double angle = 2 * std::numbers::pi * Unit();
    const double radius = std::sqrt(1 - z * z);
    return {radius * std::cos(angle), radius * std::sin(angle), z};
  }

 private:
  std::mt19937_64 engine_;
};

// Where a camera ray hit.
struct Start {
  Vec3 point;
  Vec3 normal;  // on the camera's side
  uint32_t primitive;
};

absl::StatusOr<Camera> PlaceCamera(const v1::Mesh& mesh, uint32_t side) {
  CameraOptions options;
  options.width = side;
  options.height = side;
  return Camera::Place(options, mesh);
}

void AddRay(const Vec3& origin, const Vec3& direction, std::string* rays) {
  Append(origin, rays);
  Append(direction, rays);
}

void AddCameraRays(const Camera& camera, uint32_t side, uint32_t count, std::string* rays) {
  for (uint32_t i = 0; i < count; ++i) AddRay(camera.eye(), camera.Direction(i % side, i / side), rays);
}

// Hits of the camera rays. The arrays of the reply are checked, since nothing is taken on trust.
absl::StatusOr<std::vector<Start>> FindStarts(Connection& connection, const v1::Mesh& mesh, const Camera& camera) {
  constexpr size_t kRays = size_t{kStartsSide} * kStartsSide;
  v1::CastRaysRequest request;
  request.set_mesh(mesh.id());
  request.mutable_query()->set_layout(v1::RAY_LAYOUT_FLOAT64X6);
  for (const v1::HitColumn column : {v1::HIT_COLUMN_T, v1::HIT_COLUMN_PRIMITIVE_ID, v1::HIT_COLUMN_NORMAL}) {
    request.mutable_query()->add_columns(column);
  }
  AddCameraRays(camera, kStartsSide, kRays, request.mutable_rays()->mutable_rays());
  v1::CastRaysResponse response;
  const absl::Status status = connection.CallAgain(
      mesh.id(), [&](grpc::ClientContext* context) { return connection.rays().CastRays(context, request, &response); });
  if (!status.ok()) return status;
  const v1::HitBatch& hits = response.hits();
  if (hits.t().size() != kRays * 4 || hits.primitive_id().size() != kRays * 4 || hits.normal().size() != kRays * 12) {
    return LocalError("the server's reply has columns of the wrong length");
  }

  std::vector<Start> starts;
  for (size_t i = 0; i < kRays; ++i) {
    const auto t = RowAt<float>(hits.t(), i);
    const auto normal = RowAt<std::array<float, 3>>(hits.normal(), i);
    Start start;
    start.primitive = RowAt<uint32_t>(hits.primitive_id(), i);
    if (!std::isfinite(t)) continue;  // a miss, or a hit so far away that where it is cannot be told from t
    const Vec3 direction = camera.Direction(i % kStartsSide, i / kStartsSide);
    start.point = Add(camera.eye(), Scale(direction, t));
    start.normal = {normal[0], normal[1], normal[2]};
    if (Dot(start.normal, direction) > 0) start.normal = Scale(start.normal, -1);
    starts.push_back(start);
  }
  if (starts.empty()) return LocalError("no camera ray hits the mesh, so that there is nothing to start from");
  return starts;
}

}  // namespace

absl::Status GenerateRays(Connection& connection, const v1::Mesh& mesh, GeneratedRays kind, uint32_t count,
                          uint64_t seed, v1::CompareAccuracyRequest* request) {
  if (!mesh.has_bounds()) return LocalError("the mesh is empty, so that there are no rays to make for it");
  request->mutable_query()->set_layout(v1::RAY_LAYOUT_FLOAT64X6);
  std::string* const rays = request->mutable_rays()->mutable_rays();
  Random random(seed);
  const Vec3 low = FromPoint(mesh.bounds().min());
  const Vec3 high = FromPoint(mesh.bounds().max());
  const Vec3 centre = Add(Scale(low, 0.5), Scale(high, 0.5));
  // A mesh of a single point has a sphere too.
  const double radius = std::max(Length(Subtract(high, low)) / 2, std::numeric_limits<float>::min() * 1e3);

  if (kind == GeneratedRays::kChords) {
    for (uint32_t i = 0; i < count; ++i) {
      const Vec3 from = Scale(random.Direction(), radius);
      AddRay(Add(centre, from), Subtract(Scale(random.Direction(), radius), from), rays);
    }
    return absl::OkStatus();
  }

  const bool camera_only = kind == GeneratedRays::kCamera;
  const auto side = camera_only ? static_cast<uint32_t>(std::ceil(std::sqrt(count))) : kStartsSide;
  const absl::StatusOr<Camera> camera = PlaceCamera(mesh, side);
  if (!camera.ok()) return camera.status();
  if (camera_only) {
    AddCameraRays(*camera, side, count, rays);
    return absl::OkStatus();
  }

  const absl::StatusOr<std::vector<Start>> starts = FindStarts(connection, mesh, *camera);
  if (!starts.ok()) return starts.status();
  const Vec3 light = Add(camera->eye(), Scale(Add(camera->right(), camera->up()), radius));
  v1::RayQuery& query = *request->mutable_query();
  // Not beyond the light, which is at 1.
  if (kind == GeneratedRays::kShadow && !(query.has_t_max() && query.t_max() < 1)) query.set_t_max(1);
  for (uint32_t i = 0; i < count; ++i) {
    const Start& start = (*starts)[random.Below(starts->size())];
    // A point of the sphere that touches the surface from outside: directions by the cosine of the angle.
    const Vec3 direction =
        kind == GeneratedRays::kShadow ? Subtract(light, start.point) : Add(start.normal, random.Direction());
    AddRay(start.point, direction, rays);
    Append(start.primitive, request->mutable_rays()->mutable_excluded_primitive_ids());
  }
  return absl::OkStatus();
}

}  // namespace deltaray
