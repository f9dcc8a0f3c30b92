// Every kernel, width and way through the tree: none leaks, and all agree with the scalar reference.

#include <cmath>
#include <cstdlib>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "gtest/gtest.h"
#include "server/build/build.h"
#include "tests/scenes/load.h"
#include "tests/scenes/random.h"
#include "tests/scenes/rays.h"
#include "tests/scenes/shapes.h"

namespace deltaray {
namespace {

constexpr Traversal kTraversals[] = {Traversal::kAuto, Traversal::kSingle, Traversal::kBatch, Traversal::kPacket,
                                     Traversal::kStream};

// Rays of each test: of the environment's DELTARAY_RAYS, else few enough for every day.
size_t RayCount() {
#ifdef DELTARAY_SANITIZED
  return 1000;
#endif
  const char* const given = std::getenv("DELTARAY_RAYS");
  return given != nullptr ? std::strtoull(given, nullptr, 10) : 40'000;
}

std::shared_ptr<const Tree> BuildNow(const std::shared_ptr<const TriangleMesh>& mesh, Builder builder,
                                     std::optional<SimdTarget> target = std::nullopt) {
  const auto build = Build::Start(mesh, {MakeConfig(builder, Preset::kBalanced), 2, nullptr, target});
  const absl::Status status = build->WaitDone();
  EXPECT_TRUE(status.ok()) << status;
  return build->snapshot()->tree;
}

class KernelsTest : public testing::TestWithParam<SimdTarget> {};

INSTANTIATE_TEST_SUITE_P(Targets, KernelsTest, testing::ValuesIn(SupportedSimdTargets()),
                         [](const auto& info) { return std::string(Name(info.param)); });

// Rays at vertices and edges of a closed sphere, from within and, where it faces them, from outside.
TEST_P(KernelsTest, NoRayLeaksThroughAClosedMesh) {
  for (const double away : {0.0, 1000.0}) {
    const Vec3d centre{away, away, away};
    TriangleMesh made;
    AddSphere(&made, centre, 1, 60);
    const auto mesh = std::make_shared<const TriangleMesh>(std::move(made));
    const auto tree = BuildNow(mesh, Builder::kHybrid, GetParam());
    Random random(17);
    std::vector<Ray> rays(RayCount() / 2);
    for (size_t i = 0; i < rays.size(); ++i) {
      const auto& corners = mesh->indices[random.Below(static_cast<uint32_t>(mesh->indices.size()))];
      const uint32_t corner = random.Below(3);
      const Vec3f a = mesh->positions[corners[corner]], b = mesh->positions[corners[(corner + 1) % 3]];
      const float part = i % 2 == 0 ? 0 : static_cast<float>(random.Below(4096)) / 4096;
      const Vec3f target = a + part * (b - a);
      const auto coordinate = [&] { return static_cast<double>(random.Below(1001)) / 1000 - 0.5; };
      const Vec3d inside{coordinate(), coordinate(), coordinate()};
      // From outside: from where the target is, away from the centre, and a little aside.
      const Vec3d outside = static_cast<Vec3d>(target) - centre + 0.5 * inside;
      rays[i].origin = static_cast<Vec3f>(centre + (i % 4 < 2 ? 0.9 * inside : 2.0 * outside));
      rays[i].direction = target - rays[i].origin;
    }
    for (const Traversal traversal : kTraversals) {
      const QueryOptions options{.accuracy = AccuracyLevel::kWatertight, .traversal = traversal};
      std::vector<Hit> hits(rays.size());
      std::vector<uint8_t> any(rays.size());
      tree->ClosestHits(rays, options, hits);
      tree->AnyHits(rays, options, any);
      size_t leaks = 0;
      for (size_t i = 0; i < rays.size(); ++i) leaks += !hits[i].IsHit() + !any[i];
      EXPECT_EQ(leaks, 0u) << "of " << 2 * rays.size() << " rays, " << away << " away, traversal "
                           << static_cast<int>(traversal);
    }
  }
}

// At kExact to the bit; else the same triangle, or one at the same t, but for rays that pass an edge within rounding.
TEST_P(KernelsTest, AgreeWithTheScalarReference) {
  for (const char* const name : {"bunny", "city", "soup"}) {
    SCOPED_TRACE(name);
    absl::StatusOr<TriangleMesh> loaded = LoadScene(name);
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    const auto mesh = std::make_shared<const TriangleMesh>(*std::move(loaded));
    const auto reference = BuildNow(mesh, Builder::kTang2015), tree = BuildNow(mesh, Builder::kHybrid, GetParam());
    const auto half = static_cast<uint32_t>(RayCount() / 2);
    const auto side = static_cast<uint32_t>(std::sqrt(half));
    std::vector<Ray> rays = CameraRays(MeshBounds(*mesh), side, side);
    const std::vector<Ray> chords = ChordRays(MeshBounds(*mesh), half, 23);
    rays.insert(rays.end(), chords.begin(), chords.end());
    std::vector<Hit> expected(rays.size()), hits(rays.size());
    std::vector<uint8_t> expected_any(rays.size()), any(rays.size());
    reference->ClosestHits(rays, {}, expected);
    reference->AnyHits(rays, {}, expected_any);
    for (const Traversal traversal : kTraversals) {
      for (const AccuracyLevel level : {AccuracyLevel::kFast, AccuracyLevel::kWatertight, AccuracyLevel::kExact}) {
        SCOPED_TRACE(absl::StrFormat("traversal %d, level %d", static_cast<int>(traversal), static_cast<int>(level)));
        const QueryOptions options{.accuracy = level, .traversal = traversal};
        tree->ClosestHits(rays, options, hits);
        tree->AnyHits(rays, options, any);
        if (level == AccuracyLevel::kExact) {
          EXPECT_TRUE(hits == expected);
          EXPECT_TRUE(any == expected_any);
          continue;
        }
        size_t others = 0;
        for (size_t i = 0; i < rays.size(); ++i) {
          const bool same_t = hits[i].IsHit() == expected[i].IsHit() &&
                              (!hits[i].IsHit() || std::abs(hits[i].t - expected[i].t) <= 1e-4f * expected[i].t);
          others += !same_t || any[i] != expected_any[i];
        }
        EXPECT_LE(others, rays.size() / 10'000 + 3);
      }
    }
  }
}

}  // namespace
}  // namespace deltaray
