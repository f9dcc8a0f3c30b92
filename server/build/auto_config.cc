#include "server/build/auto_config.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <cstddef>
#include <functional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/build/reduce_references.h"
#include "server/geometry/bounds.h"

namespace deltaray {
namespace {

// Spatial splits are made where a line meets more boxes than this. Scans and terrain have 2.5 to 5.2, of which cutting
// saves 2 % of the SAH cost at most; a town with cables has 12 and triangles at random 29, where it saves a quarter to
// a half.
constexpr double kBoxesWorthCutting = 6;
// Up to so many triangles, clustering takes some seconds of one core at most.
constexpr size_t kClusteredTriangles = 2'000'000;

}  // namespace

double BoxesALineMeets(std::span<const Reference> references, BuildContext& context) {
  constexpr size_t kGrain = 65'536;
  const auto all = static_cast<Bounds>(SumBounds(references, context).bounds);
  const double whole = all.HalfArea();
  if (!(whole > 0)) return 0;
  const double sum = tbb::parallel_deterministic_reduce(
      tbb::blocked_range<size_t>(0, references.size(), kGrain), 0.0,
      [&](const tbb::blocked_range<size_t>& range, double sum) {
        if (context.cancelled()) return sum;
        const BuildContext::CpuTime time(context);
        for (const Reference& reference : references.subspan(range.begin(), range.size())) {
          sum += reference.bounds.HalfArea();
        }
        return sum;
      },
      std::plus<>());
  return sum / whole;
}

ChosenConfig ChooseConfig(const Config& wanted, std::span<const Reference> references, BuildContext& context) {
  ChosenConfig chosen{wanted, {}};
  if (wanted.preset != Preset::kAuto || wanted.builder != Builder::kHybrid) return chosen;
  Config& config = chosen.config;
  const Config balanced = MakeConfig(Builder::kHybrid, Preset::kBalanced);
  const Config fast = MakeConfig(Builder::kHybrid, Preset::kFast);

  const double boxes = BoxesALineMeets(references, context);
  if (boxes > kBoxesWorthCutting) {
    chosen.reasons.push_back(
        absl::StrFormat("spatial splits: a line through the mesh meets %.1f boxes of triangles, more than %g", boxes,
                        kBoxesWorthCutting));
  } else {
    config.spatial_split_gate = fast.spatial_split_gate;
    config.duplication_budget = fast.duplication_budget;
    chosen.reasons.push_back(
        absl::StrFormat("no spatial splits: a line through the mesh meets %.1f boxes of triangles, not more than %g",
                        boxes, kBoxesWorthCutting));
  }

  chosen.reasons.push_back(wanted.lazy ? "lazy: asked for"
                                       : "eager: the mesh does not tell how much of it rays will reach, and until "
                                         "they have, a lazy tree is the slower one");

  const bool clustered = references.size() <= kClusteredTriangles;
  config.preset = clustered ? Preset::kBalanced : Preset::kFast;
  if (wanted.delta == kDeltaByMesh) config.delta = clustered ? balanced.delta : fast.delta;
  chosen.reasons.push_back(absl::StrCat("delta ", config.delta, wanted.delta == kDeltaByMesh ? "" : " (asked for)",
                                        clustered ? ", clustered: " : ", not clustered: ", references.size(),
                                        " triangles are ", clustered ? "not " : "", "more than ", kClusteredTriangles));
  return chosen;
}

}  // namespace deltaray
