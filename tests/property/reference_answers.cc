#include "tests/property/reference_answers.h"

#include <algorithm>
#include <bit>
#include <iterator>
#include <limits>
#include <utility>

#include "absl/strings/str_format.h"
#include "server/tree/brute_force.h"

namespace deltaray {
namespace {

constexpr uint32_t kNoCap = std::numeric_limits<uint32_t>::max();
constexpr uint32_t kCap = 3;
// One in so many rays is asked with culling too.
constexpr size_t kCulledStride = 4;

// Unlike ==, tells +0 from -0.
bool SameBits(const Hit& a, const Hit& b) {
  const auto same = [](float x, float y) { return std::bit_cast<uint32_t>(x) == std::bit_cast<uint32_t>(y); };
  return same(a.t, b.t) && same(a.u, b.u) && same(a.v, b.v) && a.primitive == b.primitive && a.back == b.back;
}

std::string Describe(const Ray& ray) {
  return absl::StrFormat("origin (%a, %a, %a) direction (%a, %a, %a) t [%a, %a] excluded %d", ray.origin.x,
                         ray.origin.y, ray.origin.z, ray.direction.x, ray.direction.y, ray.direction.z, ray.t_min,
                         ray.t_max, ray.excluded_primitive);
}

std::string Describe(const Hit& hit) {
  return absl::StrFormat("primitive %d t %a u %a v %a back %d", hit.primitive, hit.t, hit.u, hit.v, hit.back);
}

testing::AssertionResult Differs(const char* kind, const Ray& ray, const std::string& expected,
                                 const std::string& actual) {
  return testing::AssertionFailure() << kind << " differs for " << Describe(ray) << "\n  brute force: " << expected
                                     << "\n  structure:   " << actual;
}

bool IsCulled(const Hit& hit, Culling culling) {
  return culling == Culling::kBack ? hit.back : culling == Culling::kFront && !hit.back;
}

// Whether `tree` answers all four kinds of query as expected: expected[i] are all hits of rays[i], in order.
testing::AssertionResult MatchHits(const Tree& tree, const std::vector<Ray>& rays,
                                   const std::vector<std::vector<Hit>>& expected, QueryOptions options) {
  const size_t n = rays.size();
  std::vector<Hit> closest(n);
  std::vector<uint8_t> any(n);
  std::vector<uint32_t> counts(n);
  tree.ClosestHits(rays, options, closest);
  tree.AnyHits(rays, options, any);
  tree.CountHits(rays, options, counts);
  for (size_t i = 0; i < n; ++i) {
    const Hit nearest = expected[i].empty() ? Hit() : expected[i].front();
    if (!SameBits(nearest, closest[i])) {
      return Differs("the closest hit", rays[i], Describe(nearest), Describe(closest[i]));
    }
    const int hit = expected[i].empty() ? 0 : 1;
    if (any[i] != hit) return Differs("any hit", rays[i], absl::StrFormat("%d", hit), absl::StrFormat("%d", any[i]));
    if (counts[i] != expected[i].size()) {
      return Differs("the count", rays[i], absl::StrFormat("%d", expected[i].size()), absl::StrFormat("%d", counts[i]));
    }
  }

  for (const uint32_t cap : {kNoCap, kCap}) {
    options.max_hits_per_ray = cap;
    std::vector<Hit> hits;
    tree.AllHits(rays, options, &hits, counts);
    size_t next = 0;
    for (size_t i = 0; i < n; ++i) {
      const size_t count = std::min<size_t>(expected[i].size(), cap);
      if (counts[i] != count) {
        return Differs("the number of all hits", rays[i], absl::StrFormat("%d", count),
                       absl::StrFormat("%d", counts[i]));
      }
      for (size_t k = 0; k < count; ++k, ++next) {
        if (!SameBits(expected[i][k], hits[next])) {
          return Differs("one of all hits", rays[i], Describe(expected[i][k]), Describe(hits[next]));
        }
      }
    }
    if (next != hits.size()) return testing::AssertionFailure() << "all hits has " << hits.size() - next << " too many";
  }
  return testing::AssertionSuccess();
}

}  // namespace

ReferenceAnswers::ReferenceAnswers(TrianglesView triangles, std::vector<Ray> rays) : rays_(std::move(rays)) {
  std::vector<uint32_t> counts(rays_.size());
  QueryOptions options;
  options.max_hits_per_ray = kNoCap;
  BruteForce(triangles).AllHits(rays_, options, &hits_, counts);
  begin_ = {0};
  for (const uint32_t count : counts) begin_.push_back(begin_.back() + count);
}

testing::AssertionResult ReferenceAnswers::Match(const Tree& tree, size_t first, size_t stride,
                                                 Traversal traversal) const {
  for (const Culling culling : {Culling::kNone, Culling::kBack, Culling::kFront}) {
    std::vector<Ray> rays;
    std::vector<std::vector<Hit>> expected;
    for (size_t i = first; i < rays_.size(); i += culling == Culling::kNone ? stride : kCulledStride * stride) {
      rays.push_back(rays_[i]);
      std::vector<Hit>& left = expected.emplace_back();
      std::copy_if(hits_.begin() + begin_[i], hits_.begin() + begin_[i + 1], std::back_inserter(left),
                   [&](const Hit& hit) { return !IsCulled(hit, culling); });
    }
    const testing::AssertionResult result =
        MatchHits(tree, rays, expected, {.culling = culling, .traversal = traversal});
    if (!result)
      return testing::AssertionFailure() << "culling " << static_cast<int>(culling) << ": " << result.message();
  }
  return testing::AssertionSuccess();
}

}  // namespace deltaray
