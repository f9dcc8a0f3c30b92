// What brute force answers, and whether a structure answers the same.

#ifndef TESTS_PROPERTY_REFERENCE_ANSWERS_H_
#define TESTS_PROPERTY_REFERENCE_ANSWERS_H_

#include <cstddef>
#include <cstdint>
#include <vector>

#include "gtest/gtest.h"
#include "server/geometry/ray.h"
#include "server/tree/tree.h"

namespace deltaray {

// The answers to all four kinds of query, worked out from one list of all hits: kinds that contradict each other cannot
// all match it.
class ReferenceAnswers {
 public:
  ReferenceAnswers(TrianglesView triangles, std::vector<Ray> rays);

  const std::vector<Ray>& rays() const { return rays_; }

  // Whether `tree` answers every `stride`-th ray, from `first` on, as brute force does, bit for bit: all four kinds,
  // all hits also with a cap, and some of the rays with each culling. Says how the first wrong ray differs.
  testing::AssertionResult Match(const Tree& tree, size_t first = 0, size_t stride = 1,
                                 Traversal traversal = Traversal::kAuto) const;

 private:
  std::vector<Ray> rays_;
  std::vector<Hit> hits_;      // of all rays, one after the other
  std::vector<size_t> begin_;  // hits of ray i: begin_[i] to begin_[i + 1]
};

}  // namespace deltaray

#endif  // TESTS_PROPERTY_REFERENCE_ANSWERS_H_
