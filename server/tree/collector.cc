#include "server/tree/collector.h"

#include <algorithm>

namespace deltaray {

void ClosestCollector::Add(const Candidate& candidate) {
  if (best_.primitive != kNoPrimitive && !IsBefore(candidate, best_)) return;
  best_ = candidate;
  limit_ = best_.t_upper();
}

void AllCollector::Add(const Candidate& candidate) {
  candidates_.push_back(candidate);
  // Compacting at twice the cap makes its cost per hit that of a sort.
  if (candidates_.size() >= 2 * cap_) Compact();
}

void AllCollector::Compact() {
  std::sort(candidates_.begin(), candidates_.end(),
            [this](const Candidate& a, const Candidate& b) { return IsBefore(a, b); });
  const auto is_same = [](const Candidate& a, const Candidate& b) { return a.primitive == b.primitive; };
  candidates_.erase(std::unique(candidates_.begin(), candidates_.end(), is_same), candidates_.end());
  if (candidates_.size() >= cap_) {
    candidates_.resize(cap_);
    limit_ = candidates_.back().t_upper();
  }
}

uint32_t AllCollector::AppendTo(std::vector<Hit>* hits) {
  Compact();
  for (const Candidate& candidate : candidates_) hits->push_back(Rounded(candidate));
  return static_cast<uint32_t>(candidates_.size());
}

uint32_t CountCollector::Count() {
  std::sort(primitives_.begin(), primitives_.end());
  return static_cast<uint32_t>(std::unique(primitives_.begin(), primitives_.end()) - primitives_.begin());
}

}  // namespace deltaray
