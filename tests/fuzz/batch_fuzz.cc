// The entry point of libFuzzer for requests with rays: whatever the bytes, our parser and protobuf's find the same, and
// the batch is answered in full or refused.

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "server/service/batch_answer.h"
#include "server/tree/brute_force.h"
#include "tests/fuzz/byte_reader.h"
#include "tests/fuzz/check.h"
#include "tests/sliced_message.h"

namespace deltaray {
namespace {

constexpr BatchLimits kLimits{.max_rays = 300, .max_message_bytes = 20'000};

// Two squares, one above the other, of which the upper one is in a group.
class Scene {
 public:
  Scene() {
    for (const float z : {0.0F, 1.0F}) {
      for (const Vec3f corner : {Vec3f{0, 0, z}, {1, 0, z}, {1, 1, z}, {0, 1, z}}) mesh_.positions.push_back(corner);
    }
    mesh_.indices = {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}};
    mesh_.face_ids = {0, 0, 1, 1};
    mesh_.group_ids = {kNoGroup, kNoGroup, 0, 0};
    mesh_.groups = {"upper"};
    mesh_.face_count = 2;
    tree_ = std::make_unique<BruteForce>(mesh_.triangles());
  }
  // With `moved`, of a mesh whose origin is not zero.
  TreeSnapshot Snapshot(bool moved) {
    mesh_.origin = moved ? Vec3d{1e6, -3, 0.125} : Vec3d{};
    TreeSnapshot snapshot;
    snapshot.mesh = {std::shared_ptr<void>(), &mesh_};
    snapshot.tree = {std::shared_ptr<void>(), tree_.get()};
    snapshot.final = true;
    return snapshot;
  }

 private:
  TriangleMesh mesh_;
  std::unique_ptr<BruteForce> tree_;
};

// A number as rays have them, or any bits.
double Number(ByteReader& reader) {
  constexpr double kNumbers[] = {0,
                                 0.25,
                                 0.5,
                                 1,
                                 -1,
                                 2,
                                 1e30,
                                 1e300,
                                 -1e-300,
                                 1e-45,
                                 std::numeric_limits<double>::infinity(),
                                 std::numeric_limits<double>::quiet_NaN()};
  return reader.Below(4) == 0 ? reader.Float() : reader.OneOf(kNumbers);
}

template <typename Scalar>
void AppendNumbers(ByteReader& reader, size_t count, std::string* bytes) {
  for (size_t i = 0; i < count; ++i) {
    const auto number = static_cast<Scalar>(Number(reader));
    bytes->append(reinterpret_cast<const char*>(&number), sizeof(number));
  }
}

// A request in the form of one that is right, of values that need not be.
v1::CastRaysRequest MakeRequest(ByteReader& reader) {
  v1::CastRaysRequest request;
  request.set_mesh("m");
  v1::RayQuery& query = *request.mutable_query();
  query.set_kind(static_cast<v1::QueryKind>(reader.Below(6)));
  query.set_layout(static_cast<v1::RayLayout>(reader.Below(6)));
  for (uint32_t i = reader.Below(5); i > 0; --i) query.add_columns(static_cast<v1::HitColumn>(reader.Below(10)));
  query.set_accuracy(static_cast<v1::AccuracyLevel>(reader.Below(5)));
  query.set_culling(static_cast<v1::Culling>(reader.Below(5)));
  if (reader.Below(2) == 1) query.set_t_min(static_cast<float>(Number(reader)));
  if (reader.Below(2) == 1) query.set_t_max(static_cast<float>(Number(reader)));
  if (reader.Below(4) == 0) query.set_max_hits_per_ray(reader.Below(4) == 0 ? reader.Word() : reader.Below(6));
  query.set_wait(static_cast<v1::BuildWait>(reader.Below(4)));

  const size_t rays = reader.Below(8) == 0 ? reader.Word() % (2 * kLimits.max_rays) : reader.Below(20);
  const bool doubles = query.layout() >= v1::RAY_LAYOUT_FLOAT64X6;
  const bool intervals = query.layout() == v1::RAY_LAYOUT_FLOAT32X8 || query.layout() == v1::RAY_LAYOUT_FLOAT64X8;
  const size_t numbers = rays * (intervals ? 8 : 6) + (reader.Below(16) == 0 ? 1 : 0);
  std::string& bytes = *request.mutable_rays()->mutable_rays();
  if (doubles) {
    AppendNumbers<double>(reader, numbers, &bytes);
  } else {
    AppendNumbers<float>(reader, numbers, &bytes);
  }
  if (reader.Below(3) == 0) {
    std::string& excluded = *request.mutable_rays()->mutable_excluded_primitive_ids();
    for (size_t i = rays + (reader.Below(16) == 0 ? 1 : 0); i > 0; --i) {
      excluded.append({static_cast<char>(reader.Below(6)), 0, 0, 0});
    }
  }
  return request;
}

// Each column that was asked for is there, and as long as its rows are many.
void CheckHits(const grpc::Slice& bytes, const BatchQuery& query, size_t rays) {
  v1::HitBatch hits;
  Check(hits.ParseFromArray(bytes.begin(), static_cast<int>(bytes.size())), "the reply is no HitBatch");
  Check(bytes.size() <= kLimits.max_message_bytes, "the reply is over the limit");
  Check(hits.ray_count() == rays, "the reply's number of rays");
  size_t rows = rays;
  if (query.kind == v1::QUERY_KIND_ALL_HITS) {
    Check(hits.offsets().size() == 4 * (rays + 1), "the length of offsets");
    ByteReader last({reinterpret_cast<const uint8_t*>(hits.offsets().data()) + 4 * rays, 4});
    rows = last.Word();
  }
  const struct {
    v1::HitColumn column;
    const std::string& bytes;
    size_t row_bytes;
    size_t rows;
  } columns[] = {{v1::HIT_COLUMN_T, hits.t(), 4, rows},
                 {v1::HIT_COLUMN_PRIMITIVE_ID, hits.primitive_id(), 4, rows},
                 {v1::HIT_COLUMN_FACE_ID, hits.face_id(), 4, rows},
                 {v1::HIT_COLUMN_GROUP_ID, hits.group_id(), 4, rows},
                 {v1::HIT_COLUMN_UV, hits.uv(), 8, rows},
                 {v1::HIT_COLUMN_NORMAL, hits.normal(), 12, rows},
                 {v1::HIT_COLUMN_FLAGS, hits.flags(), 1, rows},
                 {v1::HIT_COLUMN_COUNT, hits.count(), 4, rays}};
  for (const auto& [column, values, row_bytes, count] : columns) {
    Check(values.size() == (query.Wants(column) ? row_bytes * count : 0), "the length of a column");
  }
}

// Parses `bytes` in slices of `slice` bytes by both parsers and compares. Whether they are a Request.
template <typename Request>
bool ParseBoth(const std::string& bytes, size_t slice, Request* request, RayBatchBytes* rays) {
  Request expected;
  const bool ok = expected.ParseFromString(bytes);
  const absl::Status status = ParseRayMessage(InSlices(bytes, slice), request, rays);
  Check(status.ok() == ok, "our parser and protobuf's differ in whether it is a message");
  if (!ok) {
    CheckRefusal(status, {absl::StatusCode::kInvalidArgument});
    return false;
  }
  Check(Read(rays->message, rays->rays) == expected.rays().rays(), "rays");
  Check(Read(rays->message, rays->excluded_primitive_ids) == expected.rays().excluded_primitive_ids(),
        "excluded_primitive_ids");
  if (expected.has_rays()) expected.mutable_rays()->Clear();
  Check(request->SerializeAsString() == expected.SerializeAsString(), "the rest of the message");
  return true;
}

void Answer(const v1::RayQuery& message, const RayBatchBytes& rays, bool moved) {
  const absl::StatusOr<BatchQuery> query = ReadQuery(message);
  if (!query.ok()) return CheckRefusal(query.status(), {absl::StatusCode::kInvalidArgument});
  static Scene scene;
  const TreeSnapshot snapshot = scene.Snapshot(moved);
  const absl::StatusOr<BatchAnswer> answer = AnswerBatch(snapshot, *query, rays, kLimits, {});
  if (answer.ok()) {
    CheckHits(answer->hits, *query, rays.rays.size / query->RayBytes());
  } else {
    CheckRefusal(answer.status(), {absl::StatusCode::kInvalidArgument, absl::StatusCode::kResourceExhausted});
  }
}

}  // namespace
}  // namespace deltaray

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace deltaray;
  ByteReader reader({data, size});
  const uint32_t kind = reader.Below(4);
  const bool moved = reader.Below(2) == 1;
  const size_t slice = 1 + reader.Byte();
  constexpr size_t kHead = 3;
  const std::string rest(reinterpret_cast<const char*>(data) + (size < kHead ? size : kHead),
                         size < kHead ? 0 : size - kHead);
  RayBatchBytes rays;
  if (kind == 0) {
    v1::CastRaysRequest request;
    if (ParseBoth(rest, slice, &request, &rays)) Answer(request.query(), rays, moved);
  } else if (kind == 1) {
    v1::StreamRaysRequest request;
    if (ParseBoth(rest, slice, &request, &rays)) Answer(request.start().query(), rays, moved);
  } else if (kind == 2) {
    v1::CompareAccuracyRequest request;
    if (ParseBoth(rest, slice, &request, &rays)) Answer(request.query(), rays, moved);
  } else {
    v1::CastRaysRequest request;
    if (ParseBoth(MakeRequest(reader).SerializeAsString(), slice, &request, &rays)) {
      Answer(request.query(), rays, moved);
    }
  }
  return 0;
}
