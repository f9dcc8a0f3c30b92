// What a query keeps of the triangles that a traversal reaches.

#ifndef SERVER_TREE_COLLECTOR_H_
#define SERVER_TREE_COLLECTOR_H_

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "server/geometry/triangle_test.h"
#include "server/tree/stop_poll.h"
#include "server/tree/tree.h"

namespace deltaray {

// Tests triangles against one ray and keeps what the query asks for. A traversal may bring the triangles in any order,
// and the same one several times; it must bring all that the ray hits at t <= limit(), as the limit goes down.
class Collector {
 public:
  Collector(const Collector&) = delete;
  Collector& operator=(const Collector&) = delete;

  // Hits with an exact t beyond this do not matter: +inf at first, never growing, -inf once nothing matters any more.
  double limit() const { return limit_; }
  bool IsDone() const { return limit_ == kNothingMatters; }
  // Traversals step it where they may go far without a visit, and end where it says so. Visit() does so itself, and
  // then nothing matters any more.
  StopPoll& stop() const { return stop_; }

  // Tests the triangles with these primitive ids, as long as they matter.
  void Visit(std::span<const uint32_t> primitives) {
    for (const uint32_t primitive : primitives) {
      if (IsDone()) return;
      Visit(primitive);
    }
  }
  void Visit(uint32_t primitive) {
    if (stop_.Step()) limit_ = kNothingMatters;
    Candidate candidate;
    if (primitive != ray_.excluded_primitive && !IsDone() &&
        TestTriangle(ray_, triangles_[primitive], primitive, culling_, &candidate)) {
      Add(candidate);
    }
  }

 protected:
  static constexpr double kNothingMatters = -std::numeric_limits<double>::infinity();

  Collector(const TrianglesView& triangles, const Ray& ray, Culling culling, StopPoll& stop)
      : triangles_(triangles), ray_(ray), culling_(culling), stop_(stop) {}
  ~Collector() = default;

  virtual void Add(const Candidate& candidate) = 0;

  bool IsBefore(const Candidate& a, const Candidate& b) const { return Before(ray_, triangles_, a, b); }
  Hit Rounded(const Candidate& candidate) const { return Round(ray_, triangles_, candidate); }

  double limit_ = std::numeric_limits<double>::infinity();

 private:
  const TrianglesView& triangles_;
  const Ray& ray_;
  const Culling culling_;
  StopPoll& stop_;
};

// The first hit.
class ClosestCollector final : public Collector {
 public:
  ClosestCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options, StopPoll& stop)
      : Collector(triangles, ray, options.culling, stop) {}

  // kNoPrimitive where none is hit.
  uint32_t primitive() const { return best_.primitive; }
  Hit hit() const { return best_.primitive == kNoPrimitive ? Hit() : Rounded(best_); }

 private:
  void Add(const Candidate& candidate) override;

  Candidate best_;
};

// Whether there is a hit.
class AnyCollector final : public Collector {
 public:
  AnyCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options, StopPoll& stop)
      : Collector(triangles, ray, options.culling, stop) {}

  bool any() const { return IsDone(); }

 private:
  void Add(const Candidate&) override { limit_ = kNothingMatters; }
};

// The first options.max_hits_per_ray hits, each triangle once, in order.
class AllCollector final : public Collector {
 public:
  // Uses `candidates` as storage.
  AllCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options, StopPoll& stop,
               std::vector<Candidate>* candidates)
      : Collector(triangles, ray, options.culling, stop), cap_(options.max_hits_per_ray), candidates_(*candidates) {
    candidates_.clear();
  }

  // Returns the number of hits that it appended to `hits`.
  uint32_t AppendTo(std::vector<Hit>* hits);

 private:
  void Add(const Candidate& candidate) override;

  // Orders the candidates, and drops repeated ones and those past the cap; all of them where the query is to end.
  void Compact();

  const size_t cap_;
  std::vector<Candidate>& candidates_;
};

// The number of triangles hit. Few are listed; many are marked, in a bit for each triangle of the mesh, so that they
// take bounded memory however many there are.
class CountCollector final : public Collector {
 public:
  struct Storage {
    std::vector<uint32_t> list;
    std::vector<bool> marks;  // none: they are listed
  };

  CountCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options, StopPoll& stop,
                 Storage* storage);

  uint32_t Count();

 private:
  void Add(const Candidate& candidate) override;
  void Mark(uint32_t primitive);

  const size_t triangle_count_;
  Storage& storage_;
  uint32_t marked_ = 0;
};

}  // namespace deltaray

#endif  // SERVER_TREE_COLLECTOR_H_
