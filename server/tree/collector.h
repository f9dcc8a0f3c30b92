// What a query keeps of the triangles that a traversal reaches.

#ifndef SERVER_TREE_COLLECTOR_H_
#define SERVER_TREE_COLLECTOR_H_

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "server/geometry/triangle_test.h"
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
  bool IsDone() const { return limit_ == -std::numeric_limits<double>::infinity(); }

  // Tests the triangles with these primitive ids.
  void Visit(std::span<const uint32_t> primitives) {
    for (const uint32_t primitive : primitives) Visit(primitive);
  }
  void Visit(uint32_t primitive) {
    Candidate candidate;
    if (primitive != ray_.excluded_primitive && !IsDone() &&
        TestTriangle(ray_, triangles_[primitive], primitive, culling_, &candidate)) {
      Add(candidate);
    }
  }

 protected:
  Collector(const TrianglesView& triangles, const Ray& ray, Culling culling)
      : triangles_(triangles), ray_(ray), culling_(culling) {}
  ~Collector() = default;

  virtual void Add(const Candidate& candidate) = 0;

  bool IsBefore(const Candidate& a, const Candidate& b) const { return Before(ray_, triangles_, a, b); }
  Hit Rounded(const Candidate& candidate) const { return Round(ray_, triangles_, candidate); }

  double limit_ = std::numeric_limits<double>::infinity();

 private:
  const TrianglesView& triangles_;
  const Ray& ray_;
  const Culling culling_;
};

// The first hit.
class ClosestCollector final : public Collector {
 public:
  ClosestCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options)
      : Collector(triangles, ray, options.culling) {}

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
  AnyCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options)
      : Collector(triangles, ray, options.culling) {}

  bool any() const { return IsDone(); }

 private:
  void Add(const Candidate&) override { limit_ = -std::numeric_limits<double>::infinity(); }
};

// The first options.max_hits_per_ray hits, each triangle once, in order.
class AllCollector final : public Collector {
 public:
  // Uses `candidates` as storage.
  AllCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options,
               std::vector<Candidate>* candidates)
      : Collector(triangles, ray, options.culling), cap_(options.max_hits_per_ray), candidates_(*candidates) {
    candidates_.clear();
  }

  // Returns the number of hits that it appended to `hits`.
  uint32_t AppendTo(std::vector<Hit>* hits);

 private:
  void Add(const Candidate& candidate) override;

  // Orders the candidates, and drops repeated ones and those past the cap.
  void Compact();

  const size_t cap_;
  std::vector<Candidate>& candidates_;
};

// The number of triangles hit.
class CountCollector final : public Collector {
 public:
  // Uses `primitives` as storage.
  CountCollector(const TrianglesView& triangles, const Ray& ray, const QueryOptions& options,
                 std::vector<uint32_t>* primitives)
      : Collector(triangles, ray, options.culling), primitives_(*primitives) {
    primitives_.clear();
  }

  uint32_t Count();

 private:
  void Add(const Candidate& candidate) override { primitives_.push_back(candidate.primitive); }

  std::vector<uint32_t>& primitives_;
};

}  // namespace deltaray

#endif  // SERVER_TREE_COLLECTOR_H_
