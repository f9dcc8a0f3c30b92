// From hits to the columns of a reply.

#ifndef SERVER_SERVICE_HIT_COLUMNS_H_
#define SERVER_SERVICE_HIT_COLUMNS_H_

#include <cstddef>
#include <cstdint>
#include <span>

#include "deltaray/v1/ray_service.pb.h"
#include "server/mesh/triangle_mesh.h"
#include "server/service/batch_query.h"

namespace deltaray {

// Bytes that one row takes in all columns wanted that have a row per hit: all but counts and offsets.
uint64_t BytesPerHit(const BatchQuery& query);
// Bytes that one ray takes, whatever it hits: the columns that have a row per ray.
uint64_t BytesPerRay(const BatchQuery& query);

// The columns of a v1::HitBatch while they are filled. The bytes are those that ray_service.proto documents.
//
// Threads may write disjoint ranges of rows at the same time.
class HitColumns {
 public:
  // Makes room for `hits` rows in the columns that have a row per hit, and `rays` in those that have one per ray.
  // `batch` must outlive this.
  HitColumns(const BatchQuery& query, size_t rays, size_t hits, v1::HitBatch* batch);

  // CLOSEST_HIT and ALL_HITS: rows from `first` on. Ids in `hits` are kNoPrimitive or of `mesh`.
  void WriteHits(size_t first, std::span<const Hit> hits, const TriangleMesh& mesh);
  // ANY_HIT: 1 or 0 for each ray from `first` on.
  void WriteAny(size_t first, std::span<const uint8_t> any);
  // COUNT_HITS and ALL_HITS.
  void WriteCounts(size_t first, std::span<const uint32_t> counts);

 private:
  // Where each column begins; nullptr: not wanted.
  char* t_ = nullptr;
  char* primitive_id_ = nullptr;
  char* face_id_ = nullptr;
  char* group_id_ = nullptr;
  char* uv_ = nullptr;
  char* normal_ = nullptr;
  char* flags_ = nullptr;
  char* count_ = nullptr;
};

// Appends the columns of `part` to those of `whole`.
void AppendColumns(const v1::HitBatch& part, v1::HitBatch* whole);

}  // namespace deltaray

#endif  // SERVER_SERVICE_HIT_COLUMNS_H_
