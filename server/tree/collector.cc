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
  // std::sort can be left only by an exception.
  struct Stopped {};
  try {
    std::sort(candidates_.begin(), candidates_.end(), [this](const Candidate& a, const Candidate& b) {
      if (stop().Step()) throw Stopped();
      return IsBefore(a, b);
    });
  } catch (Stopped) {
    candidates_.clear();
    limit_ = kNothingMatters;
    return;
  }
  const auto is_same = [](const Candidate& a, const Candidate& b) { return a.primitive == b.primitive; };
  candidates_.erase(std::unique(candidates_.begin(), candidates_.end(), is_same), candidates_.end());
  if (candidates_.size() >= cap_) {
    candidates_.resize(cap_);
    limit_ = candidates_.back().t_upper();
  }
}

uint32_t AllCollector::AppendTo(std::vector<Hit>* hits) {
  Compact();
  const size_t before = hits->size();
  for (const Candidate& candidate : candidates_) {
    if (stop().Step()) break;
    hits->push_back(Rounded(candidate));
  }
  return static_cast<uint32_t>(hits->size() - before);
}

CountCollector::CountCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options,
                               StopPoll& stop, Storage* storage)
    : Collector(triangles, ray, options.culling, stop), triangle_count_(triangles.size()), storage_(*storage) {
  storage_.list.clear();
  storage_.marks.clear();
}

void CountCollector::Add(const Candidate& candidate) {
  if (!storage_.marks.empty()) return Mark(candidate.primitive);
  storage_.list.push_back(candidate.primitive);
  // As much memory as the marks take; and they are cleared for a ray only where it has hit so many.
  if (storage_.list.size() * 32 < triangle_count_) return;
  storage_.marks.assign(triangle_count_, false);
  for (const uint32_t primitive : storage_.list) Mark(primitive);
}

void CountCollector::Mark(uint32_t primitive) {
  marked_ += !storage_.marks[primitive];
  storage_.marks[primitive] = true;
}

uint32_t CountCollector::Count() {
  if (!storage_.marks.empty()) return marked_;
  std::vector<uint32_t>& list = storage_.list;
  std::sort(list.begin(), list.end());
  return static_cast<uint32_t>(std::unique(list.begin(), list.end()) - list.begin());
}

}  // namespace deltaray
