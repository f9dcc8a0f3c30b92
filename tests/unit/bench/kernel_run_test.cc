#include "tests/bench/kernel_run.h"

#include <atomic>
#include <cmath>
#include <limits>
#include <vector>

#include "gtest/gtest.h"

namespace deltaray {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();

// Answers each ray with the x of its origin.
class EchoKernel final : public Kernel {
 public:
  explicit EchoKernel(std::atomic<size_t>* traced) : traced_(traced) {}
  std::unique_ptr<Worker> MakeWorker(size_t max_rays) const override {
    return std::make_unique<EchoWorker>(traced_, max_rays);
  }

 private:
  class EchoWorker final : public Worker {
   public:
    EchoWorker(std::atomic<size_t>* traced, size_t max_rays) : traced_(traced), max_rays_(max_rays) {}
    void Load(std::span<const Ray> rays) override {
      EXPECT_LE(rays.size(), max_rays_);
      rays_ = rays;
    }
    void Trace() override { *traced_ += rays_.size(); }
    void Store(std::span<Hit> hits) const override {
      ASSERT_EQ(hits.size(), rays_.size());
      for (size_t i = 0; i < hits.size(); ++i) hits[i].t = rays_[i].origin.x;
    }

   private:
    std::atomic<size_t>* const traced_;
    const size_t max_rays_;
    std::span<const Ray> rays_;
  };

  std::atomic<size_t>* const traced_;
};

TEST(TraceAllTest, GivesEachRayItsAnswerWhateverTheThreads) {
  std::vector<Ray> rays(1003);
  for (size_t i = 0; i < rays.size(); ++i) rays[i].origin.x = static_cast<float>(i);
  for (const uint32_t threads : {1u, 2u, 5u}) {
    std::atomic<size_t> traced{0};
    std::vector<Hit> hits(rays.size());
    EXPECT_GE(TraceAll(EchoKernel(&traced), rays, threads, 100, hits), 0);
    EXPECT_EQ(traced, rays.size());
    for (size_t i = 0; i < rays.size(); ++i) ASSERT_EQ(hits[i].t, rays[i].origin.x);
  }
}

TEST(MegaraysPerSecondTest, IsThatOfCoresOfTheirOwn) {
  EXPECT_DOUBLE_EQ(MegaraysPerSecond(2'000'000, 1, 0.5), 4);
  EXPECT_DOUBLE_EQ(MegaraysPerSecond(2'000'000, 2, 0.5), 8);
}

std::vector<Hit> AtEach(std::initializer_list<float> t) {
  std::vector<Hit> hits;
  for (const float each : t) hits.push_back({.t = each});
  return hits;
}

TEST(CountDisagreementsTest, ComparesMissesExactlyAndDistancesWithinTheTolerance) {
  const std::vector<Hit> expected = AtEach({1, 1, kInf, kInf, 2, 0, 0});
  const std::vector<Hit> hits = AtEach({1.0005f, 1.01f, kInf, 3, kInf, 0, 1e-30f});
  EXPECT_EQ(CountDisagreements(hits, expected, 1e-3f), 4u);
  EXPECT_EQ(CountDisagreements(hits, expected, 0), 5u);
  EXPECT_EQ(CountDisagreements(expected, expected, 0), 0u);
  EXPECT_EQ(CountDisagreements(AtEach({NAN}), AtEach({1}), 1), 1u);
}

TEST(CountDifferencesTest, ComparesAllThatAHitHoldsToTheBit) {
  const Hit hit = {.t = 0, .u = 0.25f, .v = 0.5f, .primitive = 3, .back = false};
  std::vector<Hit> others(5, hit);
  others[0].t = -0.0f;
  others[1].u = 0.25000003f;
  others[2].v = NAN;
  others[3].primitive = 4;
  others[4].back = true;
  EXPECT_EQ(CountDifferences(others, std::vector<Hit>(5, hit)), 5u);
  EXPECT_EQ(CountDifferences(others, others), 0u);
  EXPECT_EQ(CountDifferences(AtEach({kInf}), AtEach({kInf})), 0u);
}

}  // namespace
}  // namespace deltaray
