// Makes one vertex of equal positions.

#ifndef SERVER_MESH_VERTEX_MERGER_H_
#define SERVER_MESH_VERTEX_MERGER_H_

#include <cstdint>

#include "absl/container/flat_hash_set.h"
#include "absl/status/statusor.h"
#include "server/mesh/face_collector.h"

namespace deltaray {

// For formats that repeat the positions of vertices in each triangle. Positions are equal where all three coordinates
// are the same number; -0 and +0 are. Keeps one index per vertex.
class VertexMerger {
 public:
  // `collector` must outlive it, and get its vertices from here only.
  explicit VertexMerger(FaceCollector* collector)
      : collector_(*collector), indices_(/*bucket_count=*/0, Hash{collector}, Equal{collector}) {}

  // The index of the vertex at `position`, which is added where there is none yet. Errors are FaceCollector's.
  absl::StatusOr<uint32_t> Add(const Vec3d& position, Location where) {
    if (const auto found = indices_.find(position); found != indices_.end()) return *found;
    const uint32_t index = collector_.vertex_count();
    if (absl::Status status = collector_.AddVertex(position, where); !status.ok()) return status;
    indices_.insert(index);
    return index;
  }

 private:
  struct Hash {
    using is_transparent = void;
    const FaceCollector* collector;
    size_t operator()(const Vec3d& v) const {
      // Adding zero turns -0 into +0.
      return absl::HashOf(v.x + 0.0, v.y + 0.0, v.z + 0.0);
    }
    size_t operator()(uint32_t index) const { return (*this)(collector->vertex(index)); }
  };
  struct Equal {
    using is_transparent = void;
    const FaceCollector* collector;
    bool operator()(uint32_t a, const Vec3d& b) const { return collector->vertex(a) == b; }
    bool operator()(uint32_t a, uint32_t b) const { return a == b; }
  };

  FaceCollector& collector_;
  absl::flat_hash_set<uint32_t, Hash, Equal> indices_;
};

}  // namespace deltaray

#endif  // SERVER_MESH_VERTEX_MERGER_H_
