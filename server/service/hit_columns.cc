#include "server/service/hit_columns.h"

#include <bit>
#include <cstring>
#include <new>
#include <string>

#include "google/protobuf/io/coded_stream.h"
#include "server/service/triangle_normal.h"

namespace deltaray {
namespace {

using google::protobuf::io::CodedOutputStream;

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

HitColumns::HitColumns(const BatchQuery& query, size_t rays, size_t hits, Summary summary) {
  // The bytes of each column. The numbers of columns are those of the fields; offsets have a field alone.
  std::array<size_t, kColumns> sizes{};
  for (int field = v1::HIT_COLUMN_T; field <= v1::HIT_COLUMN_COUNT; ++field) {
    const auto column = static_cast<v1::HitColumn>(field);
    if (query.Wants(column)) sizes[field - 1] = (column == v1::HIT_COLUMN_COUNT ? rays : hits) * Width(column);
  }
  if (query.kind == v1::QUERY_KIND_ALL_HITS) {
    sizes[v1::HitBatch::kOffsetsFieldNumber - 1] = (rays + 1) * sizeof(uint32_t);
  }

  v1::HitBatch rest;
  rest.set_ray_count(static_cast<uint32_t>(rays));
  rest.set_accuracy(static_cast<v1::AccuracyLevel>(summary.accuracy));
  rest.set_final_tree(summary.final_tree);
  const std::string rest_bytes = rest.SerializeAsString();

  // A tag, which for these fields takes one byte, the length and the bytes. Empty columns are left out, as protobuf
  // does.
  size_t total = rest_bytes.size();
  for (const size_t size : sizes) {
    if (size != 0) total += 1 + CodedOutputStream::VarintSize64(size) + size;
  }
  // Not by gRPC, which ends the program where there is no memory.
  auto* const bytes = static_cast<char*>(operator new(total));
  bytes_ = grpc::Slice(bytes, total, [](void* memory) { operator delete(memory); });
  auto* at = reinterpret_cast<uint8_t*>(bytes);
  for (int field = 1; field <= kColumns; ++field) {
    const size_t size = sizes[field - 1];
    if (size == 0) continue;
    constexpr int kLengthDelimited = 2;
    *at++ = static_cast<uint8_t>(field << 3 | kLengthDelimited);
    at = CodedOutputStream::WriteVarint64ToArray(size, at);
    columns_[field - 1] = reinterpret_cast<char*>(at);
    at += size;
  }
  std::memcpy(at, rest_bytes.data(), rest_bytes.size());
}

void HitColumns::WriteHits(size_t first, std::span<const Hit> hits, const TriangleMesh& mesh) {
  // Column by column: in each loop nothing is decided but by the hit.
  const auto write = [&](v1::HitColumn column, const auto& value) {
    char* const bytes = Column(column);
    if (bytes == nullptr) return;
    for (size_t i = 0; i < hits.size(); ++i) Put(bytes, first + i, value(hits[i]));
  };
  write(v1::HIT_COLUMN_T, [](const Hit& hit) { return hit.t; });
  write(v1::HIT_COLUMN_PRIMITIVE_ID, [](const Hit& hit) { return hit.primitive; });
  write(v1::HIT_COLUMN_FACE_ID,
        [&mesh](const Hit& hit) { return hit.IsHit() ? mesh.FaceId(hit.primitive) : kNoPrimitive; });
  write(v1::HIT_COLUMN_GROUP_ID,
        [&mesh](const Hit& hit) { return hit.IsHit() ? mesh.GroupId(hit.primitive) : kNoGroup; });
  write(v1::HIT_COLUMN_UV, [](const Hit& hit) { return std::array<float, 2>{hit.u, hit.v}; });
  write(v1::HIT_COLUMN_NORMAL, [triangles = mesh.triangles()](const Hit& hit) {
    return hit.IsHit() ? GeometricNormal(triangles[hit.primitive]) : Vec3f();
  });
  // Without a branch, which no processor foresees where rays hit and miss at random. Misses are not on the back.
  write(v1::HIT_COLUMN_FLAGS,
        [](const Hit& hit) { return static_cast<uint8_t>(hit.IsHit() * kFlagHit | hit.back * kFlagBack); });
}

void HitColumns::WriteAny(size_t first, std::span<const uint8_t> any) {
  char* const flags = Column(v1::HIT_COLUMN_FLAGS);
  for (size_t i = 0; i < any.size(); ++i) Put(flags, first + i, any[i] != 0 ? kFlagHit : uint8_t{0});
}

void HitColumns::WriteCounts(size_t first, std::span<const uint32_t> counts) {
  char* const bytes = Column(v1::HIT_COLUMN_COUNT);
  if (bytes != nullptr) std::memcpy(bytes + first * sizeof(uint32_t), counts.data(), counts.size_bytes());
}

void HitColumns::WriteOffsets(std::span<const uint32_t> offsets) {
  std::memcpy(Column(v1::HitBatch::kOffsetsFieldNumber), offsets.data(), offsets.size_bytes());
}

}  // namespace deltaray
