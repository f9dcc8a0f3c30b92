#include "server/service/hit_columns.h"

#include <bit>
#include <cstring>
#include <string>

#include "server/service/triangle_normal.h"

namespace deltaray {
namespace {

static_assert(std::endian::native == std::endian::little, "columns are copied to the wire as they are");
static_assert(sizeof(Vec3f) == 12);

constexpr uint8_t kFlagHit = 1;
constexpr uint8_t kFlagBack = 2;

// Bytes of one row of a column.
uint64_t Width(v1::HitColumn column) {
  switch (column) {
    case v1::HIT_COLUMN_FLAGS:
      return 1;
    case v1::HIT_COLUMN_UV:
      return 8;
    case v1::HIT_COLUMN_NORMAL:
      return 12;
    default:
      return 4;
  }
}

template <typename Value>
void Put(char* column, size_t row, const Value& value) {
  std::memcpy(column + row * sizeof(Value), &value, sizeof(Value));
}

}  // namespace

uint64_t BytesPerHit(const BatchQuery& query) {
  uint64_t bytes = 0;
  for (int i = v1::HIT_COLUMN_T; i <= v1::HIT_COLUMN_FLAGS; ++i) {
    const auto column = static_cast<v1::HitColumn>(i);
    if (query.Wants(column)) bytes += Width(column);
  }
  return bytes;
}

uint64_t BytesPerRay(const BatchQuery& query) {
  const uint64_t counts = query.Wants(v1::HIT_COLUMN_COUNT) ? Width(v1::HIT_COLUMN_COUNT) : 0;
  const uint64_t offsets = query.kind == v1::QUERY_KIND_ALL_HITS ? sizeof(uint32_t) : 0;
  return counts + offsets + (query.kind == v1::QUERY_KIND_ALL_HITS ? 0 : BytesPerHit(query));
}

HitColumns::HitColumns(const BatchQuery& query, size_t rays, size_t hits, v1::HitBatch* batch) {
  const auto make = [&query](v1::HitColumn column, size_t rows, std::string* bytes) -> char* {
    if (!query.Wants(column)) return nullptr;
    bytes->resize(rows * Width(column));
    return bytes->data();
  };
  t_ = make(v1::HIT_COLUMN_T, hits, batch->mutable_t());
  primitive_id_ = make(v1::HIT_COLUMN_PRIMITIVE_ID, hits, batch->mutable_primitive_id());
  face_id_ = make(v1::HIT_COLUMN_FACE_ID, hits, batch->mutable_face_id());
  group_id_ = make(v1::HIT_COLUMN_GROUP_ID, hits, batch->mutable_group_id());
  uv_ = make(v1::HIT_COLUMN_UV, hits, batch->mutable_uv());
  normal_ = make(v1::HIT_COLUMN_NORMAL, hits, batch->mutable_normal());
  flags_ = make(v1::HIT_COLUMN_FLAGS, hits, batch->mutable_flags());
  count_ = make(v1::HIT_COLUMN_COUNT, rays, batch->mutable_count());
}

void HitColumns::WriteHits(size_t first, std::span<const Hit> hits, const TriangleMesh& mesh) {
  const TrianglesView triangles = mesh.triangles();
  for (size_t i = 0; i < hits.size(); ++i) {
    const Hit& hit = hits[i];
    const size_t row = first + i;
    if (t_ != nullptr) Put(t_, row, hit.t);
    if (primitive_id_ != nullptr) Put(primitive_id_, row, hit.primitive);
    if (face_id_ != nullptr) Put(face_id_, row, hit.IsHit() ? mesh.FaceId(hit.primitive) : kNoPrimitive);
    if (group_id_ != nullptr) Put(group_id_, row, hit.IsHit() ? mesh.GroupId(hit.primitive) : kNoGroup);
    if (uv_ != nullptr) {
      Put(uv_, 2 * row, hit.u);
      Put(uv_, 2 * row + 1, hit.v);
    }
    if (normal_ != nullptr) Put(normal_, row, hit.IsHit() ? GeometricNormal(triangles[hit.primitive]) : Vec3f());
    if (flags_ != nullptr) {
      Put(flags_, row, static_cast<uint8_t>(hit.IsHit() ? kFlagHit | (hit.back ? kFlagBack : 0) : 0));
    }
  }
}

void HitColumns::WriteAny(size_t first, std::span<const uint8_t> any) {
  for (size_t i = 0; i < any.size(); ++i) Put(flags_, first + i, any[i] != 0 ? kFlagHit : uint8_t{0});
}

void HitColumns::WriteCounts(size_t first, std::span<const uint32_t> counts) {
  if (count_ != nullptr) std::memcpy(count_ + first * sizeof(uint32_t), counts.data(), counts.size_bytes());
}

void AppendColumns(const v1::HitBatch& part, v1::HitBatch* whole) {
  whole->mutable_t()->append(part.t());
  whole->mutable_primitive_id()->append(part.primitive_id());
  whole->mutable_face_id()->append(part.face_id());
  whole->mutable_group_id()->append(part.group_id());
  whole->mutable_uv()->append(part.uv());
  whole->mutable_normal()->append(part.normal());
  whole->mutable_flags()->append(part.flags());
  whole->mutable_count()->append(part.count());
}

}  // namespace deltaray
