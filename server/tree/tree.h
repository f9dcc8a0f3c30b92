// What every finished structure can be asked.

#ifndef SERVER_TREE_TREE_H_
#define SERVER_TREE_TREE_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "server/geometry/ray.h"
#include "server/geometry/triangles.h"

namespace deltaray {

// Levels of accuracy, from the fastest to the most accurate.
enum class AccuracyLevel : uint8_t { kFast = 1, kWatertight = 2, kExact = 3 };

// How rays are led through a tree; answers do not depend on it, but for which of several surfaces is found at kFast
// where they are closer together than t is off. Structures that know one way only take that.
enum class Traversal : uint8_t {
  kAuto,    // packets or streams where the rays are coherent, batches else
  kSingle,  // one ray after the other
  kBatch,   // many rays in flight, each on its own
  kPacket,  // neighbours in the batch together, as one interval of rays
  kStream,  // neighbours in the batch together, each with its own tests; a batch where the order of hits matters
};

struct QueryOptions {
  Culling culling = Culling::kNone;
  // The least accuracy to answer with; see Tree::answered_accuracy.
  AccuracyLevel accuracy = AccuracyLevel::kExact;
  Traversal traversal = Traversal::kAuto;
  // AllHits: most hits per ray, the nearest ones. At least 1.
  uint32_t max_hits_per_ray = 64;
  // Where set, it is asked now and then on the query's thread, within a ray that takes long too: whether the answer is
  // not wanted any more. Once it has returned true it must not return false again; the query then ends soon, and what
  // it has written is of no meaning.
  const std::function<bool()>* stopped = nullptr;
};

// Size and shape of a tree, counted once.
struct TreeShape {
  uint64_t nodes = 0;       // leaves included
  uint64_t leaves = 0;      // empty kd leaves included
  uint64_t references = 0;  // at least the number of triangles
  uint32_t max_depth = 0;   // the root has depth 0
  // With Ct = Ci = 1 and areas relative to the root's. The triangles of a wide tree's leaf are tested at once and count
  // as one: its costs compare with those of wide trees of the same width.
  double sah_cost = 0;
  uint64_t node_bytes = 0;
  uint64_t reference_bytes = 0;
};

// A structure over the triangles of one mesh that is, or seems, immutable. All methods may be called from any number of
// threads at once, and take no lock. At AccuracyLevel::kExact the answer is a function of triangles and ray alone:
// every structure gives the same bits as BruteForce.
//
// `rays` and the outputs have the same length. No method throws, save for lack of memory.
class Tree {
 public:
  virtual ~Tree() = default;

  // hits[i]: the hit of rays[i] of least exact t; of several at the same t the one of the lowest primitive id.
  virtual void ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const = 0;

  // any[i]: 1 where rays[i] hits something, else 0.
  virtual void AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const = 0;

  // Appends all hits of rays[0], then those of rays[1] and so on to `hits`, each triangle at most once, ordered by
  // exact t, then primitive id; at most options.max_hits_per_ray of each ray. counts[i]: how many were appended for
  // rays[i].
  virtual void AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
                       std::span<uint32_t> counts) const = 0;

  // counts[i]: number of triangles that rays[i] hits.
  virtual void CountHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint32_t> counts) const = 0;

  // The level that ClosestHits and AnyHits asking for `level` are answered with: at least `level`. AllHits and
  // CountHits are always exact.
  virtual AccuracyLevel answered_accuracy(AccuracyLevel level) const = 0;

  // Whether a query, of however few rays, may take long because it builds more of the tree.
  virtual bool is_growing() const { return false; }

  // For a lazy tree, of what rays go through now.
  virtual TreeShape Shape() const = 0;
};

}  // namespace deltaray

#endif  // SERVER_TREE_TREE_H_
