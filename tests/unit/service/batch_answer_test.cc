#include "server/service/batch_answer.h"

#include <algorithm>
#include <atomic>
#include <limits>
#include <random>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/service/hit_columns.h"
#include "server/service/tracer.h"
#include "tests/unit/service/meshes.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

// Rays downwards from above, on the squares and beside them.
std::vector<float> Downwards(size_t count) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> unit(-0.5f, 1.5f);
  std::vector<float> rays;
  for (size_t i = 0; i < count; ++i) {
    for (float number : {unit(random), unit(random), 100.0f, 0.0f, 0.0f, -1.0f}) rays.push_back(number);
  }
  return rays;
}

std::vector<Ray> ToRays(const std::vector<float>& numbers) {
  std::vector<Ray> rays(numbers.size() / 6);
  for (size_t i = 0; i < rays.size(); ++i) {
    rays[i].origin = {numbers[6 * i], numbers[6 * i + 1], numbers[6 * i + 2]};
    rays[i].direction = {numbers[6 * i + 3], numbers[6 * i + 4], numbers[6 * i + 5]};
  }
  return rays;
}

BatchQuery Query(v1::QueryKind kind, uint32_t max_hits = 0) {
  v1::RayQuery query;
  query.set_kind(kind);
  query.set_max_hits_per_ray(max_hits);
  return *ReadQuery(query);
}

v1::RayBatch Batch(const std::vector<float>& numbers) {
  v1::RayBatch batch;
  batch.set_rays(Bytes(numbers));
  return batch;
}

// Answers on the threads of a tracer.
absl::StatusOr<v1::HitBatch> AnswerRays(const TreeSnapshot& snapshot, const BatchQuery& query,
                                        const v1::RayBatch& batch, const BatchLimits& limits = {},
                                        std::function<bool()> cancelled = nullptr) {
  if (!cancelled) cancelled = [] { return false; };
  absl::StatusOr<BatchAnswer> answer = absl::UnknownError("not run");
  Tracer tracer(2);
  tracer.Enqueue([&] { answer = AnswerBatch(snapshot, query, CopyRayBatch(batch), limits, {cancelled}); });
  tracer.Stop();
  if (!answer.ok()) return answer.status();
  return ToHitBatch(answer->hits);
}

class BatchAnswerTest : public testing::Test {
 protected:
  const std::shared_ptr<const TreeSnapshot> snapshot_ = BruteForceSnapshot(Squares(10), false);
  const std::vector<float> numbers_ = Downwards(3000);
  const std::vector<Ray> rays_ = ToRays(numbers_);
};

TEST_F(BatchAnswerTest, ClosestHitsAreThoseOfTheTree) {
  const auto answer = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_CLOSEST_HIT), Batch(numbers_));
  ASSERT_TRUE(answer.ok()) << answer.status();
  std::vector<Hit> hits(rays_.size());
  snapshot_->tree->ClosestHits(rays_, {}, hits);
  const auto t = Numbers<float>(answer->t());
  const auto primitive = Numbers<uint32_t>(answer->primitive_id());
  ASSERT_EQ(t.size(), rays_.size());
  for (size_t i = 0; i < hits.size(); ++i) {
    ASSERT_EQ(t[i], hits[i].t) << i;
    ASSERT_EQ(primitive[i], hits[i].primitive) << i;
  }
  EXPECT_EQ(answer->ray_count(), 3000u);
  EXPECT_EQ(answer->accuracy(), v1::ACCURACY_LEVEL_EXACT);
  EXPECT_FALSE(answer->final_tree());
}

TEST_F(BatchAnswerTest, AnyHitsAndCountsAreThoseOfTheTree) {
  const auto any = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_ANY_HIT), Batch(numbers_));
  const auto count = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_COUNT_HITS), Batch(numbers_));
  ASSERT_TRUE(any.ok() && count.ok());
  std::vector<uint32_t> expected(rays_.size());
  snapshot_->tree->CountHits(rays_, {}, expected);
  EXPECT_EQ(Numbers<uint32_t>(count->count()), expected);
  ASSERT_EQ(any->flags().size(), rays_.size());
  for (size_t i = 0; i < rays_.size(); ++i) ASSERT_EQ(any->flags()[i], expected[i] > 0 ? 1 : 0) << i;
}

TEST_F(BatchAnswerTest, AllHitsAreInCsrFormAcrossPieces) {
  // 70,000 hits a ray make pieces of 16 rays, so that there are many.
  for (uint32_t max_hits : {0u, 65'536u, 3u}) {
    const auto answer = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_ALL_HITS, max_hits), Batch(numbers_));
    ASSERT_TRUE(answer.ok()) << answer.status();
    QueryOptions options;
    options.max_hits_per_ray = max_hits == 0 ? 64 : max_hits;
    std::vector<Hit> hits;
    std::vector<uint32_t> counts(rays_.size()), all(rays_.size());
    snapshot_->tree->AllHits(rays_, options, &hits, counts);
    snapshot_->tree->CountHits(rays_, options, all);
    const auto offsets = Numbers<uint32_t>(answer->offsets());
    const auto t = Numbers<float>(answer->t());
    const auto primitive = Numbers<uint32_t>(answer->primitive_id());
    ASSERT_EQ(offsets.size(), rays_.size() + 1);
    ASSERT_EQ(t.size(), hits.size());
    EXPECT_EQ(offsets[0], 0u);
    for (size_t i = 0; i < rays_.size(); ++i) ASSERT_EQ(offsets[i + 1] - offsets[i], counts[i]) << i;
    for (size_t i = 0; i < hits.size(); ++i) {
      ASSERT_EQ(t[i], hits[i].t) << i;
      ASSERT_EQ(primitive[i], hits[i].primitive) << i;
    }
    // The count is of all triangles hit, also of those beyond the cap.
    EXPECT_EQ(Numbers<uint32_t>(answer->count()), all);
  }
}

TEST_F(BatchAnswerTest, AnEmptyBatchHasAnEmptyAnswer) {
  const auto closest = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_CLOSEST_HIT), {});
  ASSERT_TRUE(closest.ok());
  EXPECT_EQ(closest->ray_count(), 0u);
  EXPECT_TRUE(closest->t().empty());
  const auto all = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_ALL_HITS), {});
  ASSERT_TRUE(all.ok());
  EXPECT_EQ(all->offsets(), Bytes<uint32_t>({0}));
}

TEST_F(BatchAnswerTest, NamesTheFirstBadRayOfAll) {
  for (int repeat = 0; repeat < 20; ++repeat) {
    std::vector<float> numbers = numbers_;
    for (size_t ray : {700, 1500, 2900}) numbers[6 * ray + 1] = std::numeric_limits<float>::quiet_NaN();
    const auto answer = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_CLOSEST_HIT), Batch(numbers));
    EXPECT_EQ(answer.status(), absl::InvalidArgumentError("rays.rays: ray 700: origin.y is NaN"));
  }
}

TEST_F(BatchAnswerTest, ReplyOfKnownSizeOverTheLimitIsRefusedBeforeAnyRayIsTraced) {
  BatchLimits limits;
  limits.max_message_bytes = 3000 * 17 + 511;
  const auto answer = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_CLOSEST_HIT), Batch(numbers_), limits, [] {
    ADD_FAILURE() << "traced";
    return false;
  });
  EXPECT_EQ(answer.status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(answer.status().message()), HasSubstr("over the limit of 51511 bytes a message"));
  limits.max_message_bytes = 3000 * 17 + 512;
  EXPECT_TRUE(AnswerRays(*snapshot_, Query(v1::QUERY_KIND_CLOSEST_HIT), Batch(numbers_), limits).ok());
}

TEST_F(BatchAnswerTest, AllHitsOverTheLimitEndEarly) {
  BatchLimits limits;
  limits.max_message_bytes = 3000 * 8 + 512 + 1000;
  const auto answer = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_ALL_HITS), Batch(numbers_), limits);
  EXPECT_EQ(answer.status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(answer.status().message()), HasSubstr("bytes a message"));
}

TEST_F(BatchAnswerTest, AllHitsThatJustFitAreAnswered) {
  const BatchQuery query = Query(v1::QUERY_KIND_ALL_HITS);
  const auto answer = AnswerRays(*snapshot_, query, Batch(numbers_));
  ASSERT_TRUE(answer.ok()) << answer.status();
  const uint64_t hits = Numbers<float>(answer->t()).size();
  ASSERT_GT(hits, 1000u);
  BatchLimits limits;
  limits.max_message_bytes = rays_.size() * BytesPerRay(query) + 512 + hits * BytesPerHit(query);
  EXPECT_TRUE(AnswerRays(*snapshot_, query, Batch(numbers_), limits).ok());
  --limits.max_message_bytes;
  EXPECT_EQ(AnswerRays(*snapshot_, query, Batch(numbers_), limits).status().code(),
            absl::StatusCode::kResourceExhausted);
}

TEST_F(BatchAnswerTest, EndsSoonOnceCancelled) {
  std::atomic<int> asked{0};
  const auto answer = AnswerRays(*snapshot_, Query(v1::QUERY_KIND_CLOSEST_HIT), Batch(numbers_), {},
                                 [&asked] { return asked.fetch_add(1) >= 1; });
  EXPECT_EQ(answer.status().code(), absl::StatusCode::kCancelled);
  EXPECT_LE(asked.load(), 6);
}

// Answers few rays at once, by another tree; for more than `patient` it takes as long as it may, and leaves
// nothing of use.
class ReluctantTree final : public Tree {
 public:
  ReluctantTree(std::shared_ptr<const Tree> inner, size_t patient) : inner_(std::move(inner)), patient_(patient) {}

  void ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const override {
    if (!Waits(rays, options)) return inner_->ClosestHits(rays, options, hits);
    std::fill(hits.begin(), hits.end(), Hit{.t = 1, .u = 1, .v = 1, .primitive = 4'000'000'000});
  }
  void AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const override {
    if (!Waits(rays, options)) return inner_->AnyHits(rays, options, any);
    std::fill(any.begin(), any.end(), uint8_t{77});
  }
  void AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
               std::span<uint32_t> counts) const override {
    if (!Waits(rays, options)) return inner_->AllHits(rays, options, hits, counts);
    hits->resize(hits->size() + 1000);
    std::fill(counts.begin(), counts.end(), 4'000'000'000);
  }
  void CountHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint32_t> counts) const override {
    if (!Waits(rays, options)) return inner_->CountHits(rays, options, counts);
    std::fill(counts.begin(), counts.end(), 4'000'000'000);
  }
  AccuracyLevel answered_accuracy(AccuracyLevel level) const override { return inner_->answered_accuracy(level); }
  TreeShape Shape() const override { return inner_->Shape(); }

  mutable std::atomic<bool> waits{false};

 private:
  bool Waits(std::span<const Ray> rays, const QueryOptions& options) const {
    if (rays.size() <= patient_) return false;
    waits = true;
    while (!(*options.stopped)()) {
    }
    return true;
  }

  const std::shared_ptr<const Tree> inner_;
  const size_t patient_;
};

TEST_F(BatchAnswerTest, SlicesThatTakeTooLongAreTracedAgainWithFewerRays) {
  TreeSnapshot slow = *snapshot_;
  slow.tree = std::make_shared<ReluctantTree>(snapshot_->tree, 4);
  const v1::RayBatch batch = Batch(Downwards(25));
  for (const v1::QueryKind kind :
       {v1::QUERY_KIND_CLOSEST_HIT, v1::QUERY_KIND_ANY_HIT, v1::QUERY_KIND_ALL_HITS, v1::QUERY_KIND_COUNT_HITS}) {
    const auto answer = AnswerRays(slow, Query(kind, 3), batch);
    const auto expected = AnswerRays(*snapshot_, Query(kind, 3), batch);
    ASSERT_TRUE(answer.ok()) << answer.status();
    EXPECT_EQ(answer->SerializeAsString(), expected->SerializeAsString()) << kind;
  }
}

TEST_F(BatchAnswerTest, EndsWithinARayOnceCancelled) {
  TreeSnapshot slow = *snapshot_;
  const auto tree = std::make_shared<ReluctantTree>(snapshot_->tree, 0);
  slow.tree = tree;
  const auto answer = AnswerRays(slow, Query(v1::QUERY_KIND_CLOSEST_HIT), Batch(Downwards(1)), {},
                                 [tree] { return tree->waits.load(); });
  EXPECT_EQ(answer.status().code(), absl::StatusCode::kCancelled);
}

TEST_F(BatchAnswerTest, RaysAreInTheCoordinatesOfTheFile) {
  TriangleMesh mesh = Squares(1);
  mesh.origin = {1e7, 2e7, 0};
  v1::RayQuery v1_query;
  v1_query.set_layout(v1::RAY_LAYOUT_FLOAT64X6);
  v1::RayBatch batch;
  batch.set_rays(Bytes<double>({1e7 + 0.25, 2e7 + 0.125, 5, 0, 0, -1}));
  const auto answer = AnswerRays(*BruteForceSnapshot(mesh), *ReadQuery(v1_query), batch);
  ASSERT_TRUE(answer.ok()) << answer.status();
  EXPECT_EQ(answer->t(), Bytes<float>({5}));
  EXPECT_EQ(answer->uv(), Bytes<float>({0.125f, 0.125f}));
  EXPECT_TRUE(answer->final_tree());
}

TEST(IsSmallTest, HoldsFor256RaysAndNeverForAllHits) {
  EXPECT_TRUE(IsSmall(Query(v1::QUERY_KIND_CLOSEST_HIT), 256 * 24 + 100));
  EXPECT_FALSE(IsSmall(Query(v1::QUERY_KIND_CLOSEST_HIT), 512 * 24));
  EXPECT_FALSE(IsSmall(Query(v1::QUERY_KIND_ALL_HITS), 24));
}

}  // namespace
}  // namespace deltaray
