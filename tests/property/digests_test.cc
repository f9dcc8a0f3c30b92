// The answers at fixed scenes as one number each, committed: whatever changes any bit of any answer is seen here, and
// so is a build option, a thread, a processor or a compiler that does.

#include <tbb/global_control.h>

#include <algorithm>
#include <bit>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "gtest/gtest.h"
#include "server/build/build.h"
#include "tests/property/gated_build.h"
#include "tests/scenes/hard_rays.h"
#include "tests/scenes/load.h"
#include "tests/scenes/pathological.h"
#include "tests/scenes/rays.h"

namespace deltaray {
namespace {

struct Row {
  std::string_view scene;
  uint32_t size;  // 0: that of LoadScene
  uint64_t inputs;
  uint64_t answers;
};

// Scenes and rays that are made without sine, logarithm and the like, of which libraries round some differently. Where
// `inputs` differs, mesh or rays are others, and nothing is said of the answers.
constexpr Row kRows[] = {
    {"bunny", 0, 0x6B9F6BD55CD5FC95, 0xB1BD845FB6351391},
    {"integer_grid", 600, 0xFF0808E152ED4AA6, 0x200FB5DE08A0D4A7},
    {"voxels", 64, 0x3A6B9C194151B304, 0xDD110C7D38FA0EDD},
    {"nested_boxes", 40, 0x7EEAC008DEE29148, 0x87932129BFBA857F},
    {"coincident", 24, 0x05CD40816D9D410E, 0x898825CA21542676},
    {"huge_among_tiny", 1000, 0xD2110183CE15B8C0, 0x52C0AB1D081BBA45},
    {"half_degenerate", 600, 0xE64D85F8E27249C4, 0x11C0B6E3CD35ACC9},
    {"coplanar_overlap", 80, 0x9ED74853AE864D3B, 0x12DE9256310C0759},
    {"t_junctions", 400, 0xD9EFB70137931813, 0x1AEB932AFDCB2868},
    {"geometric_series", 60, 0xEA594A39BD136C62, 0xBEF2632C4C246C3D},
    {"needle_fan", 100, 0xD351B60EC6510882, 0xB2833BAF916E0BD1},
    {"ulp_cracks", 400, 0x8910AB091FDD7483, 0x7C329E34761F2786},
    {"ulp_layers", 40, 0x2EBDEF5ECE7FB6C5, 0xD7C667C43DBFE7C6},
    {"any_bits", 60, 0x9EAA5BE6F9896EA8, 0x5EE89D360D3317C6},
};
constexpr std::string_view kRays[] = {"at_vertices",  "at_edges",      "along_axes", "in_axis_planes",
                                      "from_surface", "odd_intervals", "in_planes",  "of_any_bits"};
constexpr uint32_t kRaysOfEach = 30;

// FNV-1a, of 32-bit words as little-endian bytes.
class Digest {
 public:
  void Add(uint32_t word) {
    for (int i = 0; i < 4; ++i) value_ = (value_ ^ (word >> (8 * i) & 0xFF)) * 0x100000001B3;
  }
  void Add(float x) { Add(std::bit_cast<uint32_t>(x)); }
  void Add(Vec3f a) {
    for (int axis = 0; axis < 3; ++axis) Add(a[axis]);
  }
  void Add(std::span<const Hit> hits) {
    for (const Hit& hit : hits) {
      for (const float x : {hit.t, hit.u, hit.v}) Add(x);
      Add(hit.primitive);
      Add(static_cast<uint32_t>(hit.back));
    }
  }
  uint64_t value() const { return value_; }

 private:
  uint64_t value_ = 0xCBF29CE484222325;
};

std::vector<Ray> DigestRays(const TriangleMesh& mesh) {
  std::vector<Ray> rays = ChordRays(MeshBounds(mesh), kRaysOfEach, 1);
  for (const HardRays& family : HardRayFamilies()) {
    if (std::ranges::find(kRays, family.name) == std::end(kRays)) continue;
    const std::vector<Ray> more = family.make(mesh, kRaysOfEach, 2);
    rays.insert(rays.end(), more.begin(), more.end());
  }
  return rays;
}

uint64_t DigestOfInputs(const TriangleMesh& mesh, std::span<const Ray> rays) {
  Digest digest;
  for (const Vec3f& p : mesh.positions) digest.Add(p);
  for (const auto& corners : mesh.indices) {
    for (const uint32_t corner : corners) digest.Add(corner);
  }
  for (const Ray& ray : rays) {
    digest.Add(ray.origin);
    digest.Add(ray.direction);
    digest.Add(ray.t_min);
    digest.Add(ray.t_max);
  }
  return digest.value();
}

// Of all queries, asked by `threads` threads, each its share of the rays.
uint64_t DigestOfAnswers(const Tree& tree, std::span<const Ray> rays, Traversal traversal, uint32_t threads) {
  struct Share {
    std::vector<Hit> closest[3], all;  // closest: by culling
    std::vector<uint8_t> any;
    std::vector<uint32_t> listed, counted;
  };
  std::vector<Share> shares(threads);
  const auto answer = [&](size_t i) {
    const size_t begin = rays.size() * i / threads, end = rays.size() * (i + 1) / threads, n = end - begin;
    const std::span<const Ray> part = rays.subspan(begin, n);
    Share& share = shares[i];
    for (const Culling culling : {Culling::kNone, Culling::kBack, Culling::kFront}) {
      std::vector<Hit>& closest = share.closest[static_cast<size_t>(culling)];
      closest.resize(n);
      tree.ClosestHits(part, {.culling = culling, .traversal = traversal}, closest);
    }
    share.any.resize(n);
    tree.AnyHits(part, {.traversal = traversal}, share.any);
    share.listed.resize(n);
    tree.AllHits(part, {}, &share.all, share.listed);
    share.counted.resize(n);
    tree.CountHits(part, {}, share.counted);
  };
  std::vector<std::thread> others;
  for (size_t i = 1; i < threads; ++i) others.emplace_back(answer, i);
  answer(0);
  for (std::thread& other : others) other.join();

  Digest digest;
  for (size_t culling = 0; culling < 3; ++culling) {
    for (const Share& share : shares) digest.Add(share.closest[culling]);
  }
  for (const Share& share : shares) {
    for (const uint8_t any : share.any) digest.Add(static_cast<uint32_t>(any));
  }
  for (const Share& share : shares) {
    for (const uint32_t count : share.listed) digest.Add(count);
  }
  for (const Share& share : shares) digest.Add(share.all);
  for (const Share& share : shares) {
    for (const uint32_t count : share.counted) digest.Add(count);
  }
  return digest.value();
}

class DigestsTest : public testing::TestWithParam<Row> {
 protected:
  void SetUp() override {
    const Row& row = GetParam();
    absl::StatusOr<TriangleMesh> mesh = absl::NotFoundError("no such scene");
    if (row.size == 0) mesh = LoadScene(row.scene);
    for (const PathologicalScene& scene : PathologicalScenes()) {
      if (row.size != 0 && scene.name == row.scene) mesh = scene.make(row.size);
    }
    ASSERT_TRUE(mesh.ok()) << mesh.status();
    mesh_ = std::make_shared<const TriangleMesh>(*std::move(mesh));
    rays_ = DigestRays(*mesh_);
    ASSERT_EQ(DigestOfInputs(*mesh_, rays_), row.inputs) << absl::StrFormat(
        "other mesh or rays: inputs of %s are 0x%016X", std::string(row.scene), DigestOfInputs(*mesh_, rays_));
  }

  void Check(const Tree& tree, Traversal traversal = Traversal::kAuto, uint32_t threads = 1) const {
    const uint64_t digest = DigestOfAnswers(tree, rays_, traversal, threads);
    EXPECT_EQ(digest, GetParam().answers)
        << absl::StrFormat("0x%016X, traversal %d, traced by %d threads", digest, static_cast<int>(traversal), threads);
  }

  void BuildAndCheck(const Config& config, uint32_t threads = 2) const {
    SCOPED_TRACE(absl::StrFormat("builder %d, preset %d, delta %d, alpha %g, %d threads%s",
                                 static_cast<int>(config.builder), static_cast<int>(config.preset), config.delta,
                                 config.alpha, threads, config.lazy ? ", lazy" : ""));
    const auto build = Build::Start(mesh_, {config, threads, nullptr});
    ASSERT_TRUE(build->WaitDone().ok());
    Check(*build->snapshot()->tree, Traversal::kAuto, threads);
    // A lazy tree has built by then what rays reach.
    if (config.lazy) Check(*build->snapshot()->tree, Traversal::kAuto, threads);
  }

  std::shared_ptr<const TriangleMesh> mesh_;
  std::vector<Ray> rays_;
};

INSTANTIATE_TEST_SUITE_P(Scenes, DigestsTest, testing::ValuesIn(kRows),
                         [](const auto& info) { return std::string(info.param.scene); });

TEST_P(DigestsTest, AreThoseOfEveryBuilderAndPreset) {
  for (const Builder builder :
       {Builder::kHybrid, Builder::kKdTree, Builder::kBvh, Builder::kSbvh, Builder::kTang2015}) {
    for (const Preset preset : {Preset::kFast, Preset::kBalanced, Preset::kBest, Preset::kAuto}) {
      BuildAndCheck(MakeConfig(builder, preset));
    }
  }
}

TEST_P(DigestsTest, AreThoseOfEveryDeltaAndAlpha) {
  for (const uint32_t delta : {1, 7, 64, 4096}) {
    for (const double alpha : {0.0, 0.3, 1.0}) {
      Config config;
      config.delta = delta;
      config.alpha = alpha;
      BuildAndCheck(config);
    }
    Config lazy;
    lazy.delta = delta;
    lazy.lazy = true;
    BuildAndCheck(lazy);
  }
}

TEST_P(DigestsTest, AreThoseOfAnyNumberOfThreads) {
  constexpr uint32_t kMost = 8;
  // Also on fewer processors.
  const tbb::global_control workers(tbb::global_control::max_allowed_parallelism, kMost);
  for (uint32_t threads = 1; threads <= kMost; ++threads) BuildAndCheck(Config(), threads);
}

TEST_P(DigestsTest, AreThoseOfEveryVectorWidthAndTraversal) {
  for (const SimdTarget target : SupportedSimdTargets()) {
    for (const Builder builder : {Builder::kHybrid, Builder::kBvh, Builder::kSbvh}) {
      SCOPED_TRACE(absl::StrFormat("%s, builder %d", Name(target), static_cast<int>(builder)));
      const auto build = Build::Start(mesh_, {MakeConfig(builder, Preset::kBalanced), 2, nullptr, target});
      ASSERT_TRUE(build->WaitDone().ok());
      for (const Traversal traversal :
           {Traversal::kAuto, Traversal::kSingle, Traversal::kBatch, Traversal::kPacket, Traversal::kStream}) {
        Check(*build->snapshot()->tree, traversal);
      }
    }
  }
}

TEST_P(DigestsTest, AreTheSameWhileTheBuildRunsAndAfterIt) {
  for (const Builder builder : {Builder::kHybrid, Builder::kTang2015}) {
    SCOPED_TRACE(static_cast<int>(builder));
    GatedBuild gated(mesh_, MakeConfig(builder, Preset::kBalanced), 2);
    ASSERT_TRUE(gated.build->WaitProvisional().ok());
    const uint64_t leaves = gated.build->progress().delta_leaves;
    if (leaves > 1) {
      const std::shared_ptr<const TreeSnapshot> early = gated.build->snapshot();
      EXPECT_FALSE(early->final);
      Check(*early->tree);
      gated.Advance(leaves / 2);
      Check(*early->tree);
    }
    gated.turnstile->Let(kAllLeaves);
    ASSERT_TRUE(gated.build->WaitDone().ok());
    Check(*gated.build->snapshot()->tree);
  }
}

}  // namespace
}  // namespace deltaray
