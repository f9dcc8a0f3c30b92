#include "server/service/accuracy_comparison.h"

#include <atomic>
#include <chrono>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

bool Never() { return false; }

// A tree of the brute force's answers, which are wrong in a way of its own at each level but EXACT: rays 0 to 3 of a
// batch miss, hit, hit something else and hit a little too far.
class WrongTree final : public Tree {
 public:
  explicit WrongTree(std::shared_ptr<const TreeSnapshot> inner) : inner_(std::move(inner)) {}

  void ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const override {
    inner_->tree->ClosestHits(rays, options, hits);
    if (options.accuracy == AccuracyLevel::kExact) return;
    hits[0] = Hit();
    hits[1] = Hit{.t = 1, .primitive = 3};
    hits[2].primitive = 9;
    hits[2].t = 1;
    hits[3].t = std::nextafter(std::nextafter(hits[3].t, 1e9f), 1e9f);
    hits[3].u += 0.25f;
    // Another primitive at the same t is right.
    hits[4].primitive = 9;
  }
  void AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const override {
    inner_->tree->AnyHits(rays, options, any);
    if (options.accuracy == AccuracyLevel::kFast) any[0] = 0;
    if (options.accuracy == AccuracyLevel::kWatertight) any[1] = 1;
  }
  void AllHits(std::span<const Ray>, const QueryOptions&, std::vector<Hit>*, std::span<uint32_t>) const override {}
  void CountHits(std::span<const Ray>, const QueryOptions&, std::span<uint32_t>) const override {}
  AccuracyLevel answered_accuracy(AccuracyLevel level) const override { return level; }
  TreeShape Shape() const override { return {.node_bytes = 640, .reference_bytes = 320}; }

 private:
  const std::shared_ptr<const TreeSnapshot> inner_;
};

// Five rays downwards, of which the second one misses.
v1::CompareAccuracyRequest FiveRays() {
  v1::CompareAccuracyRequest request;
  for (int i = 0; i < 5; ++i) {
    request.mutable_rays()->mutable_rays()->append(Bytes<float>({i == 1 ? 7.0f : 0.5f, 0.25f, 20, 0, 0, -1}));
  }
  request.set_rounds(2);
  return request;
}

absl::StatusOr<v1::CompareAccuracyResponse> CompareOnWrongTree(const v1::CompareAccuracyRequest& request,
                                                               const std::function<bool()>& cancelled = Never) {
  const auto inner = BruteForceSnapshot(Squares(3));
  TreeSnapshot snapshot = *inner;
  snapshot.tree = std::make_shared<WrongTree>(inner);
  const absl::StatusOr<ComparisonQuery> comparison = ReadComparison(request);
  if (!comparison.ok()) return comparison.status();
  return CompareAccuracy(snapshot, *comparison, CopyRayBatch(request.rays()), 100, {cancelled});
}

TEST(AccuracyComparisonTest, CountsEachKindOfWrongAnswer) {
  const auto response = CompareOnWrongTree(FiveRays());
  ASSERT_TRUE(response.ok()) << response.status();
  EXPECT_EQ(response->ray_count(), 5u);
  EXPECT_EQ(response->hit_count(), 4u);
  EXPECT_EQ(response->node_bytes(), 640u);
  EXPECT_EQ(response->reference_bytes(), 320u);
  EXPECT_GT(response->mesh_bytes(), 0u);
  ASSERT_EQ(response->levels_size(), 3);
  for (int i = 0; i < 3; ++i) {
    const v1::AccuracyMeasurement& level = response->levels(i);
    const uint64_t wrong = i < 2 ? 1 : 0;
    EXPECT_EQ(level.accuracy(), static_cast<v1::AccuracyLevel>(i + 1));
    EXPECT_EQ(level.answered_accuracy(), level.accuracy());
    EXPECT_EQ(level.false_misses(), wrong);
    EXPECT_EQ(level.false_hits(), wrong);
    EXPECT_EQ(level.wrong_primitives(), wrong);
    EXPECT_EQ(level.t_error_ulp_max(), 2 * wrong);
    EXPECT_EQ(level.t_error_ulp_p999(), 2 * wrong);
    EXPECT_EQ(level.uv_error_max(), 0.25 * static_cast<double>(wrong));
    EXPECT_GT(level.nanoseconds_per_ray(), 0);
  }
}

TEST(AccuracyComparisonTest, AnyHitHasMissesAndHitsOnly) {
  v1::CompareAccuracyRequest request = FiveRays();
  request.mutable_query()->set_kind(v1::QUERY_KIND_ANY_HIT);
  const auto response = CompareOnWrongTree(request);
  ASSERT_TRUE(response.ok()) << response.status();
  EXPECT_EQ(response->hit_count(), 4u);
  EXPECT_EQ(response->levels(0).false_misses(), 1u);
  EXPECT_EQ(response->levels(0).false_hits(), 0u);
  EXPECT_EQ(response->levels(1).false_misses(), 0u);
  EXPECT_EQ(response->levels(1).false_hits(), 1u);
  EXPECT_EQ(response->levels(2).false_misses() + response->levels(2).false_hits(), 0u);
}

TEST(AccuracyComparisonTest, RefusesWhatHasNoMeaning) {
  const auto error_after = [](auto change) {
    v1::CompareAccuracyRequest request = FiveRays();
    change(request);
    const absl::Status status = CompareOnWrongTree(request).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
    return std::string(status.message());
  };
  EXPECT_EQ(error_after([](auto& r) { r.mutable_query()->add_columns(v1::HIT_COLUMN_T); }),
            "query.columns: must be unset in CompareAccuracy");
  EXPECT_EQ(error_after([](auto& r) { r.mutable_query()->set_accuracy(v1::ACCURACY_LEVEL_FAST); }),
            "query.accuracy: must be unset in CompareAccuracy");
  EXPECT_EQ(error_after([](auto& r) { r.mutable_query()->set_wait(v1::BUILD_WAIT_FINAL); }),
            "query.wait: must be unset in CompareAccuracy");
  EXPECT_THAT(error_after([](auto& r) { r.mutable_query()->set_kind(v1::QUERY_KIND_ALL_HITS); }),
              HasSubstr("query.kind: QUERY_KIND_ALL_HITS has one accuracy level"));
  EXPECT_EQ(error_after([](auto& r) { r.set_rounds(33); }), "rounds: 33 is not in the range 1 to 32, nor 0");
  EXPECT_EQ(error_after([](auto& r) { r.clear_rays(); }), "rays.rays: there are none to compare by");
  EXPECT_THAT(error_after([](auto& r) { r.mutable_rays()->mutable_rays()->append("x"); }), HasSubstr("multiple"));
}

TEST(AccuracyComparisonTest, StopsWhereItIsCancelled) {
  int asked = 0;
  const auto in_the_third_pass = [&asked] { return ++asked > 2; };
  EXPECT_EQ(CompareOnWrongTree(FiveRays(), in_the_third_pass).status().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(asked, 3);
}

class CompareAccuracyTest : public RunningServer {
 protected:
  grpc::Status Compare(const v1::CompareAccuracyRequest& request, v1::CompareAccuracyResponse* response,
                       std::chrono::milliseconds deadline = std::chrono::minutes(1)) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + deadline);
    return rays_->CompareAccuracy(&context, request, response);
  }
};

TEST_F(CompareAccuracyTest, AnswersFromTheFinalTree) {
  Start();
  const std::string id = UploadSquares(10, 0, "squares");
  v1::CompareAccuracyRequest request = FiveRays();
  request.set_mesh("squares");
  v1::CompareAccuracyResponse response;
  const grpc::Status status = Compare(request, &response);
  ASSERT_TRUE(status.ok()) << status.error_message();
  EXPECT_EQ(response.mesh_id(), id);
  EXPECT_EQ(response.hit_count(), 4u);
  ASSERT_EQ(response.levels_size(), 3);
  EXPECT_EQ(response.levels(2).false_misses() + response.levels(2).false_hits() + response.levels(2).wrong_primitives(),
            0u);
  EXPECT_GT(response.node_bytes() + response.reference_bytes(), 0u);
}

TEST_F(CompareAccuracyTest, ErrorsAreThoseOfCastRays) {
  options_.batch.max_rays = 4;
  Start();
  UploadSquares(10, 0, "squares");
  v1::CompareAccuracyRequest request = FiveRays();
  v1::CompareAccuracyResponse response;
  request.set_mesh("nothing");
  EXPECT_EQ(Compare(request, &response).error_code(), grpc::StatusCode::NOT_FOUND);
  request.set_mesh("squares");
  EXPECT_EQ(Compare(request, &response).error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  request.mutable_rays()->set_rays(Bytes<float>({0, 0, 0, 0, INFINITY, 1}));
  const grpc::Status status = Compare(request, &response);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(status.error_message(), HasSubstr("rays.rays: ray 0"));
}

TEST_F(CompareAccuracyTest, EndsSoonAfterTheDeadline) {
  std::atomic<int> queries = 0;
  Start({.on_query = [&queries](size_t) {
    ++queries;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }});
  UploadSquares(10, 0, "squares");
  v1::CompareAccuracyRequest request = FiveRays();
  request.set_mesh("squares");
  request.set_rounds(32);
  v1::CompareAccuracyResponse response;
  EXPECT_EQ(Compare(request, &response, std::chrono::milliseconds(200)).error_code(),
            grpc::StatusCode::DEADLINE_EXCEEDED);
  // Of 99 queries that would have been made.
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  EXPECT_LT(queries, 60);
}

}  // namespace
}  // namespace deltaray
