// Every family, in every structure, for every vector width and way through the tree: not one answer is wrong.

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "gtest/gtest.h"
#include "server/build/build.h"
#include "tests/oracle/judge.h"
#include "tests/oracle/oracle.h"
#include "tests/stability/families.h"

namespace deltaray {
namespace {

// Rays of a family: of the environment's DELTARAY_RAYS, else few enough for every day.
uint32_t RayCount() {
#ifdef DELTARAY_SANITIZED
  return 40;
#endif
  const char* const given = std::getenv("DELTARAY_RAYS");
  return given != nullptr ? static_cast<uint32_t>(std::strtoul(given, nullptr, 10)) : 600;
}

// Of the rays whose closest hit is asked, one in so many is asked for all hits, their count and with culling too.
constexpr size_t kStride = 8;
constexpr Culling kCullings[] = {Culling::kBack, Culling::kFront};

// Calls trace(first, count) for pieces of `rays`, on all processors.
template <typename Trace>
void InPieces(size_t rays, Trace trace) {
  constexpr size_t kPiece = 1024;
  tbb::parallel_for(tbb::blocked_range<size_t>(0, (rays + kPiece - 1) / kPiece, 1), [&](const auto& range) {
    for (size_t i = range.begin(); i < range.end(); ++i) trace(i * kPiece, std::min(kPiece, rays - i * kPiece));
  });
}

std::vector<Hit> ClosestHits(const Tree& tree, std::span<const Ray> rays, const QueryOptions& options) {
  std::vector<Hit> hits(rays.size());
  InPieces(rays.size(), [&](size_t first, size_t count) {
    tree.ClosestHits(rays.subspan(first, count), options, std::span(hits).subspan(first, count));
  });
  return hits;
}

std::vector<uint8_t> AnyHits(const Tree& tree, std::span<const Ray> rays, const QueryOptions& options) {
  std::vector<uint8_t> any(rays.size());
  InPieces(rays.size(), [&](size_t first, size_t count) {
    tree.AnyHits(rays.subspan(first, count), options, std::span(any).subspan(first, count));
  });
  return any;
}

// The right answers to the rays of a family.
class Truth {
 public:
  explicit Truth(const StabilityFamily& family)
      : rays_(family.rays), oracle_(family.mesh->triangles()), closest_(oracle_.ClosestHits(rays_)) {
    for (size_t i = 0; i < rays_.size(); i += kStride) sample_.push_back(rays_[i]);
    for (size_t c = 0; c < culled_.size(); ++c) culled_[c] = oracle_.ClosestHits(sample_, kCullings[c]);
    all_.resize(sample_.size());
    tbb::parallel_for(size_t{0}, sample_.size(), [&](size_t i) { all_[i] = oracle_.AllHits(sample_[i]); });
  }

  // Closest and any hit of all rays.
  void Check(const Tree& tree, Traversal traversal) const {
    ExpectClosest(tree, rays_, closest_, {.traversal = traversal});
    const std::vector<uint8_t> any = AnyHits(tree, rays_, {.traversal = traversal});
    size_t wrong = 0;
    for (size_t i = 0; i < rays_.size(); ++i) wrong += (any[i] != 0) != closest_[i].has_value();
    EXPECT_EQ(wrong, 0u) << "any hits";
  }

  // All hits, their count, and closest hits with culling, of the sample.
  void CheckSample(const Tree& tree) const {
    for (size_t c = 0; c < culled_.size(); ++c) {
      ExpectClosest(tree, sample_, culled_[c], {.culling = kCullings[c]});
    }
    InPieces(sample_.size(), [&](size_t first, size_t count) {
      const auto rays = std::span(sample_).subspan(first, count);
      std::vector<Hit> hits;
      std::vector<uint32_t> listed(count), counted(count);
      tree.AllHits(rays, {.max_hits_per_ray = std::numeric_limits<uint32_t>::max()}, &hits, listed);
      tree.CountHits(rays, {}, counted);
      size_t next = 0;
      for (size_t i = 0; i < count; ++i) {
        const std::vector<OracleHit>& expected = all_[first + i];
        ASSERT_EQ(counted[i], expected.size());
        ASSERT_EQ(listed[i], expected.size());
        for (const OracleHit& hit : expected) {
          ASSERT_TRUE(IsRight(hit, hits[next])) << Describe(rays[i], hit, hits[next]);
          ++next;
        }
      }
    });
  }

  // How many closest hits are wrong at a level, of each kind, recorded as properties of the test.
  void Record(const Tree& tree, AccuracyLevel level, const std::string& name) const {
    const std::vector<Hit> hits = ClosestHits(tree, rays_, {.accuracy = level});
    std::array<size_t, 5> verdicts{};
    for (size_t i = 0; i < rays_.size(); ++i) {
      ++verdicts[static_cast<size_t>(Judge(oracle_, rays_[i], closest_[i], hits[i].primitive))];
    }
    testing::Test::RecordProperty(
        name, absl::StrFormat("%d false misses, %d false hits, %d wrong surfaces, %d wrong primitives of %d",
                              verdicts[1], verdicts[2], verdicts[3], verdicts[4], rays_.size()));
  }

 private:
  static void ExpectClosest(const Tree& tree, std::span<const Ray> rays,
                            const std::vector<std::optional<OracleHit>>& expected, const QueryOptions& options) {
    const std::vector<Hit> hits = ClosestHits(tree, rays, options);
    size_t wrong = 0;
    std::string first;
    for (size_t i = 0; i < rays.size(); ++i) {
      if (IsRight(expected[i], hits[i])) continue;
      if (wrong++ == 0) first = Describe(rays[i], expected[i], hits[i]);
    }
    EXPECT_EQ(wrong, 0u) << "closest hits of " << rays.size() << ", culling " << static_cast<int>(options.culling)
                         << ", the first: " << first;
  }

  const std::vector<Ray>& rays_;
  const Oracle oracle_;
  const std::vector<std::optional<OracleHit>> closest_;
  std::vector<Ray> sample_;
  std::array<std::vector<std::optional<OracleHit>>, std::size(kCullings)> culled_;
  std::vector<std::vector<OracleHit>> all_;
};

std::shared_ptr<const Tree> BuildTree(const StabilityFamily& family, Builder builder, bool lazy,
                                      std::optional<SimdTarget> target) {
  Config config = MakeConfig(builder, Preset::kBalanced);
  config.lazy = lazy;
  const auto build = Build::Start(family.mesh, {config, 0, nullptr, target});
  const absl::Status status = build->WaitDone();
  EXPECT_TRUE(status.ok()) << status;
  return status.ok() ? build->snapshot()->tree : nullptr;
}

class StabilityTest : public testing::TestWithParam<std::string> {};

INSTANTIATE_TEST_SUITE_P(Families, StabilityTest, testing::ValuesIn(StabilityFamilyNames()),
                         [](const auto& info) { return info.param; });

TEST_P(StabilityTest, IsExact) {
  const absl::StatusOr<StabilityFamily> family = MakeStabilityFamily(GetParam(), RayCount());
  ASSERT_TRUE(family.ok()) << family.status();
  const Truth truth(*family);

  // Those that are traced ray by ray.
  for (const auto& [name, builder, lazy] :
       {std::tuple("kd_tree", Builder::kKdTree, false), std::tuple("tang2015", Builder::kTang2015, false),
        std::tuple("lazy hybrid", Builder::kHybrid, true)}) {
    SCOPED_TRACE(name);
    const auto tree = BuildTree(*family, builder, lazy, std::nullopt);
    ASSERT_NE(tree, nullptr);
    truth.Check(*tree, Traversal::kAuto);
    truth.CheckSample(*tree);
  }
  // Wide trees.
  for (const SimdTarget target : SupportedSimdTargets()) {
    for (const auto& [name, builder] :
         {std::pair("bvh", Builder::kBvh), std::pair("sbvh", Builder::kSbvh), std::pair("hybrid", Builder::kHybrid)}) {
      const auto tree = BuildTree(*family, builder, false, target);
      ASSERT_NE(tree, nullptr);
      for (const auto& [way, traversal] :
           {std::pair("auto", Traversal::kAuto), std::pair("single", Traversal::kSingle),
            std::pair("batch", Traversal::kBatch), std::pair("packet", Traversal::kPacket),
            std::pair("stream", Traversal::kStream)}) {
        SCOPED_TRACE(absl::StrCat(name, " ", Name(target), " ", way));
        truth.Check(*tree, traversal);
      }
      SCOPED_TRACE(absl::StrCat(name, " ", Name(target)));
      truth.CheckSample(*tree);
      if (builder != Builder::kHybrid || target != SupportedSimdTargets().back()) continue;
      truth.Record(*tree, AccuracyLevel::kFast, "fast");
      truth.Record(*tree, AccuracyLevel::kWatertight, "watertight");
    }
  }
}

}  // namespace
}  // namespace deltaray
