// The entry point of libFuzzer: whatever mesh, rays and tree some bytes stand for, every answer at EXACT is the
// oracle's, and the other levels answer with numbers. Ends the process where that is not so.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "server/build/build.h"
#include "server/tree/simd_target.h"
#include "tests/fuzz/exact_input.h"
#include "tests/oracle/judge.h"
#include "tests/oracle/oracle.h"

namespace deltaray {
namespace {

// Left in an answer by whoever forgets to write it.
constexpr Hit kUnwritten{.t = -1, .u = -1, .v = -1, .primitive = 0xFFFFFFFE, .back = false};
constexpr uint8_t kUnwrittenAny = 0xFF;

class ExactCheck {
 public:
  explicit ExactCheck(const ExactInput& input)
      : input_(input), mesh_(std::make_shared<const TriangleMesh>(input.mesh)), oracle_(mesh_->triangles()) {
    for (const Ray& ray : input_.rays) truth_.push_back(oracle_.AllHits(ray, input_.options.culling));
    // Held until the end: a lazy tree is built by the rays that reach it.
    build_ = Build::Start(mesh_, {input_.config, 1, nullptr, input_.target});
    if (const absl::Status status = build_->WaitDone(); !status.ok()) Fail(status.ToString());
    tree_ = build_->snapshot()->tree;
  }

  void Run() const {
    for (const AccuracyLevel level : {AccuracyLevel::kFast, AccuracyLevel::kWatertight, AccuracyLevel::kExact}) {
      QueryOptions options = input_.options;
      options.accuracy = level;
      const bool exact = tree_->answered_accuracy(level) == AccuracyLevel::kExact;
      CheckClosest(options, exact);
      CheckAny(options, exact);
    }
    CheckAll();
    CheckCounts();
  }

 private:
  [[noreturn]] void Fail(const std::string& what) const {
    std::fputs(absl::StrFormat("builder %d preset %d delta %d alpha %g gate %g budget %g lazy %d, %s, traversal %d, "
                               "culling %d, %d triangles, %d rays: %s\n",
                               static_cast<int>(input_.config.builder), static_cast<int>(input_.config.preset),
                               input_.config.delta, input_.config.alpha, input_.config.spatial_split_gate,
                               input_.config.duplication_budget, input_.config.lazy, Name(input_.target),
                               static_cast<int>(input_.options.traversal), static_cast<int>(input_.options.culling),
                               mesh_->indices.size(), input_.rays.size(), what)
                   .c_str(),
               stderr);
    std::abort();
  }
  [[noreturn]] void FailAt(const char* what, size_t ray, const std::optional<OracleHit>& truth, const Hit& hit) const {
    std::string corners;
    for (const uint32_t primitive : {truth.value_or(OracleHit()).primitive, hit.primitive}) {
      if (primitive >= mesh_->indices.size()) continue;
      const Triangle t = mesh_->triangles()[primitive];
      corners += absl::StrFormat("\n  primitive %d: (%a, %a, %a) (%a, %a, %a) (%a, %a, %a)", primitive, t.v0.x, t.v0.y,
                                 t.v0.z, t.v1.x, t.v1.y, t.v1.z, t.v2.x, t.v2.y, t.v2.z);
    }
    Fail(absl::StrFormat("%s, ray %d: %s%s", what, ray, Describe(input_.rays[ray], truth, hit), corners));
  }

  std::optional<OracleHit> Closest(size_t ray) const {
    if (truth_[ray].empty()) return std::nullopt;
    return truth_[ray].front();
  }

  void CheckClosest(const QueryOptions& options, bool exact) const {
    std::vector<Hit> hits(input_.rays.size(), kUnwritten);
    tree_->ClosestHits(input_.rays, options, hits);
    for (size_t i = 0; i < hits.size(); ++i) {
      const Hit& hit = hits[i];
      if (exact) {
        if (!IsRight(Closest(i), hit)) FailAt("closest hit", i, Closest(i), hit);
      } else if (hit.IsHit()) {
        // t may be beyond float's range, and so infinite, at every level.
        const bool sound = hit.primitive < mesh_->indices.size() &&
                           hit.primitive != input_.rays[i].excluded_primitive && !std::isnan(hit.t) &&
                           std::isfinite(hit.u) && std::isfinite(hit.v);
        if (!sound) FailAt(options.accuracy == AccuracyLevel::kFast ? "FAST" : "WATERTIGHT", i, Closest(i), hit);
      } else if (hit != Hit()) {
        FailAt("miss", i, Closest(i), hit);
      }
    }
  }

  void CheckAny(const QueryOptions& options, bool exact) const {
    std::vector<uint8_t> any(input_.rays.size(), kUnwrittenAny);
    tree_->AnyHits(input_.rays, options, any);
    for (size_t i = 0; i < any.size(); ++i) {
      if (any[i] > 1 || (exact && any[i] == truth_[i].empty())) {
        FailAt(absl::StrFormat("any hit %d", any[i]).c_str(), i, Closest(i), Hit());
      }
    }
  }

  void CheckAll() const {
    std::vector<Hit> hits;
    std::vector<uint32_t> counts(input_.rays.size(), kNoPrimitive);
    tree_->AllHits(input_.rays, input_.options, &hits, counts);
    size_t next = 0;
    for (size_t i = 0; i < counts.size(); ++i) {
      const size_t expected = std::min<size_t>(truth_[i].size(), input_.options.max_hits_per_ray);
      if (counts[i] != expected) {
        FailAt(absl::StrFormat("%d of %d hits", counts[i], expected).c_str(), i, Closest(i), Hit());
      }
      for (size_t j = 0; j < expected; ++j, ++next) {
        if (!IsRight(truth_[i][j], hits[next])) FailAt("all hits", i, truth_[i][j], hits[next]);
      }
    }
    if (next != hits.size()) Fail("more hits than counted");
  }

  void CheckCounts() const {
    std::vector<uint32_t> counts(input_.rays.size(), kNoPrimitive);
    tree_->CountHits(input_.rays, input_.options, counts);
    for (size_t i = 0; i < counts.size(); ++i) {
      if (counts[i] == truth_[i].size()) continue;
      FailAt(absl::StrFormat("count %d, not %d", counts[i], truth_[i].size()).c_str(), i, Closest(i), Hit());
    }
  }

  const ExactInput& input_;
  const std::shared_ptr<const TriangleMesh> mesh_;
  const Oracle oracle_;
  std::vector<std::vector<OracleHit>> truth_;
  std::shared_ptr<Build> build_;
  std::shared_ptr<const Tree> tree_;
};

}  // namespace
}  // namespace deltaray

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (deltaray::SupportedSimdTargets().empty()) return 0;
  const deltaray::ExactInput input = deltaray::ReadExactInput({data, size});
  deltaray::ExactCheck(input).Run();
  return 0;
}
