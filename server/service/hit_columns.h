// From hits to the columns of a reply.

#ifndef SERVER_SERVICE_HIT_COLUMNS_H_
#define SERVER_SERVICE_HIT_COLUMNS_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>

#include "deltaray/v1/ray_service.pb.h"
#include "grpcpp/support/slice.h"
#include "server/mesh/triangle_mesh.h"
#include "server/service/batch_query.h"

namespace deltaray {

// Bytes that one row takes in all columns wanted that have a row per hit: all but counts and offsets.
uint64_t BytesPerHit(const BatchQuery& query);
// Bytes that one ray takes, whatever it hits: the columns that have a row per ray.
uint64_t BytesPerRay(const BatchQuery& query);

// A v1::HitBatch while its columns are filled, in the bytes that protobuf would make of it: they are laid out once, and
// nothing is copied on the way to the network. The bytes of the columns are those that ray_service.proto documents.
//
// Threads may write disjoint ranges of rows at the same time.
class HitColumns {
 public:
  // What a v1::HitBatch says besides its columns.
  struct Summary {
    AccuracyLevel accuracy;
    bool final_tree;
  };

  // Makes room for `hits` rows in the columns that have a row per hit, and `rays` in those that have one per ray.
  // Throws std::bad_alloc. REQUIRES: `hits` and `rays` are below 2^32, and the whole takes less than 2 GiB.
  HitColumns(const BatchQuery& query, size_t rays, size_t hits, Summary summary);

  // CLOSEST_HIT and ALL_HITS: rows from `first` on. Ids in `hits` are kNoPrimitive or of `mesh`.
  void WriteHits(size_t first, std::span<const Hit> hits, const TriangleMesh& mesh);
  // ANY_HIT: 1 or 0 for each ray from `first` on.
  void WriteAny(size_t first, std::span<const uint8_t> any);
  // COUNT_HITS and ALL_HITS; of ALL_HITS it may be that no counts are wanted.
  void WriteCounts(size_t first, std::span<const uint32_t> counts);
  // ALL_HITS: all row numbers, one more than there are rays.
  void WriteOffsets(std::span<const uint32_t> offsets);

  // The message. REQUIRES: all rows are written; called once.
  grpc::Slice Take() { return std::move(bytes_); }

 private:
  static constexpr int kColumns = v1::HitBatch::kOffsetsFieldNumber;

  char* Column(int field) const { return columns_[field - 1]; }

  // Where the column of each field of v1::HitBatch begins; nullptr: not wanted.
  std::array<char*, kColumns> columns_{};
  grpc::Slice bytes_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_HIT_COLUMNS_H_
