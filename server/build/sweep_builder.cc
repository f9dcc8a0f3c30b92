#include "server/build/sweep_builder.h"

#include <vector>

#include "server/build/object_split.h"
#include "server/build/top_down.h"

namespace deltaray {
namespace {

class SweepBuilder {
 public:
  SweepBuilder(std::span<const Reference> references, const BuildContext& context)
      : references_(references.begin(), references.end()), context_(context) {
    // Their places are ids of clusters, and serve as keys as well as those of triangles.
    for (uint32_t i = 0; i < references_.size(); ++i) references_[i].primitive = i;
    dendrogram_.reserve(references.size() - 1);
  }

  Dendrogram Build() {
    Bounds bounds;
    for (const Reference& reference : references_) bounds.Extend(reference.bounds);
    Split(references_, bounds, 0);
    return std::move(dendrogram_);
  }

 private:
  // Returns the cluster of all `references`.
  uint32_t Split(std::span<Reference> references, const Bounds& bounds, uint32_t depth) {
    if (references.size() == 1 || context_.cancelled()) return references[0].primitive;
    const ObjectSplit split = depth < kSahDepth ? SweepObjectSplit(references) : MedianSplit(references, bounds);
    const size_t middle = Partition(references, split, context_);
    if (context_.cancelled()) return references[0].primitive;
    const uint32_t left = Split(references.first(middle), split.left, depth + 1);
    const uint32_t right = Split(references.subspan(middle), split.right, depth + 1);
    dendrogram_.push_back({left, right});
    return static_cast<uint32_t>(references_.size() + dendrogram_.size() - 1);
  }

  std::vector<Reference> references_;
  const BuildContext& context_;
  Dendrogram dendrogram_;
};

}  // namespace

Dendrogram SplitBySweeps(std::span<const Reference> references, const BuildContext& context) {
  return SweepBuilder(references, context).Build();
}

}  // namespace deltaray
