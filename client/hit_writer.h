// Writes hits as they arrive, one row a ray, or one row a hit for ALL_HITS.

#ifndef CLIENT_HIT_WRITER_H_
#define CLIENT_HIT_WRITER_H_

#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "deltaray/v1/ray_service.pb.h"

namespace deltaray {

// Text of a hit has these columns, in this order, of those asked for:
//   ray            number of the ray in the whole input, from 0
//   t              shortest decimal that reads back as the same float32
//   primitive_id, face_id, group_id
//   u, v
//   nx, ny, nz     normal
//   hit, back      flags; ANY_HIT has only hit
//   count          of the ray; with ALL_HITS on each of its rows, and more than those where some are cut off
// CSV has a header; misses have t "inf" and ids 4294967295, as on the wire; hit and back are 0 or 1. JSON is one object
// a line, where t of a miss and ids that are none are null, and hit and back are booleans. The table is for reading and
// has the content of the CSV. Raw rows are the columns' bytes packed without padding, as in a numpy structured array;
// the ray, uint64, is only in ALL_HITS.
enum class HitFormat { kCsv, kJson, kTable, kRaw };

// The columns that are written for a query kind: `asked`, or, where that is empty, all that the kind has, but face ids,
// group ids and normals; in the order of their numbers. A UsageError where a column is repeated or the kind lacks it.
absl::StatusOr<std::vector<v1::HitColumn>> ResolveColumns(v1::QueryKind kind, const std::vector<v1::HitColumn>& asked);

// Not thread-safe.
class HitWriter {
 public:
  // `columns` as ResolveColumns() gives them. `output` must outlive the writer.
  HitWriter(HitFormat format, v1::QueryKind kind, std::vector<v1::HitColumn> columns, std::FILE* output)
      : format_(format), kind_(kind), columns_(std::move(columns)), output_(output) {}

  // Writes the hits of the next batch, and the header before the first, where the format has one. A LocalError where a
  // column has not the length that the batch's ray count asks for, or the offsets are not in order: nothing of the
  // batch is then written.
  absl::Status Write(const v1::HitBatch& hits);

  // After the last batch: writes the header where there was none.
  absl::Status End();

 private:
  absl::Status Check(const v1::HitBatch& hits) const;
  void AppendHeader();
  // Writes out what was appended.
  absl::Status Flush();
  // `ray`: its number in the batch.
  void AppendRow(const v1::HitBatch& hits, uint32_t ray, size_t row);
  void AppendTextRow(const v1::HitBatch& hits, uint32_t ray, size_t row);

  const HitFormat format_;
  const v1::QueryKind kind_;
  const std::vector<v1::HitColumn> columns_;
  std::FILE* const output_;
  bool begun_ = false;
  uint64_t next_ray_ = 0;
  std::string buffer_;
};

}  // namespace deltaray

#endif  // CLIENT_HIT_WRITER_H_
