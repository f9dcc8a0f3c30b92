#include "server/tree/leaf_recorder.h"

#include <atomic>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/build/build_context.h"
#include "server/build/wide_layout.h"
#include "server/tree/wide_tree.h"
#include "tests/unit/tree/small_trees.h"

namespace deltaray {
namespace {

using testing::ElementsAre;
using testing::Field;
using testing::IsEmpty;

class LeafRecorderTest : public testing::TestWithParam<SimdTarget> {};

INSTANTIATE_TEST_SUITE_P(Targets, LeafRecorderTest, testing::ValuesIn(SupportedSimdTargets()),
                         [](const auto& info) { return std::string(Name(info.param)); });

// Triangles apart from each other in x, too many for one leaf, and rays at some of them.
struct Row {
  static constexpr uint32_t kTriangles = 64;

  SmallScene scene;
  BvhArrays binary;
  Row() {
    for (uint32_t i = 0; i < kTriangles; ++i) {
      const auto x = static_cast<float>(10 * i);
      scene.Add({{x, 0, 0}, {x + 1, 0, 0}, {x, 1, 0}});
    }
    binary = MakeBvh(scene.view(), 1, 0);
  }
  static Ray At(uint32_t triangle) {
    return {.origin = {10 * static_cast<float>(triangle) + 0.1f, 0.1f, -1}, .direction = {0, 0, 1}};
  }
};

TEST_P(LeafRecorderTest, EveryQueryRecordsTheLeavesThatItTestsOnce) {
  const Row row;
  BuildContext context;
  std::vector<LeafReferences> leaves;
  absl::StatusOr<WideArrays> arrays = LayOutWide(row.binary, row.scene.view(), GetParam(), context, &leaves);
  ASSERT_TRUE(arrays.ok());
  const WideTree tree(row.scene.view(), *std::move(arrays));
  // Each leaf's label is where its references begin; the one with triangle 3 has none.
  const auto label_of = [&](uint32_t triangle) {
    for (const LeafReferences& leaf : leaves) {
      for (uint32_t i = leaf.begin; i < leaf.begin + leaf.count; ++i) {
        if (row.binary.references[i] == triangle) return leaf.begin;
      }
    }
    return LeafRecorder::kNoLabel;
  };
  const auto make_labels = [&] {
    std::vector<std::atomic<uint32_t>> labels(leaves.size());
    for (size_t i = 0; i < labels.size(); ++i) {
      labels[i] = leaves[i].count == 0 || leaves[i].begin == label_of(3) ? LeafRecorder::kNoLabel : leaves[i].begin;
    }
    return labels;
  };

  const std::vector<Ray> rays(16, Row::At(40)), unlabelled(16, Row::At(3));
  std::vector<Hit> hits(16);
  std::vector<uint8_t> any(16);
  std::vector<uint32_t> counts(16);
  std::vector<std::function<void(std::span<const Ray>)>> queries = {
      [&](std::span<const Ray> r) { tree.AllHits(r, {}, &hits, counts); },
      [&](std::span<const Ray> r) { tree.CountHits(r, {}, counts); }};
  for (const Traversal traversal : {Traversal::kSingle, Traversal::kBatch, Traversal::kPacket, Traversal::kStream}) {
    for (const AccuracyLevel level : {AccuracyLevel::kFast, AccuracyLevel::kWatertight, AccuracyLevel::kExact}) {
      const QueryOptions options{.accuracy = level, .traversal = traversal};
      queries.push_back(
          [&, options](std::span<const Ray> r) { tree.ClosestHits(r, options, std::span(hits).first(16)); });
      queries.push_back([&, options](std::span<const Ray> r) { tree.AnyHits(r, options, any); });
    }
  }
  for (const auto& query : queries) {
    std::vector<std::atomic<uint32_t>> labels = make_labels();
    LeafRecorder recorder(tree.arrays(), labels);
    query(rays);
    EXPECT_THAT(recorder.Take(), ElementsAre(Field(&LeafRecorder::Leaf::label, label_of(40))));
    query(rays);
    query(unlabelled);
    EXPECT_THAT(recorder.Take(), IsEmpty());
  }

  // What is not taken, as where a query throws, is there for the next one.
  std::vector<std::atomic<uint32_t>> labels = make_labels();
  {
    LeafRecorder recorder(tree.arrays(), labels);
    queries[0](rays);
  }
  {
    LeafRecorder recorder(tree.arrays(), labels);
    queries[0](rays);
    EXPECT_THAT(recorder.Take(), ElementsAre(Field(&LeafRecorder::Leaf::label, label_of(40))));
  }
  EXPECT_EQ(LeafRecorder::current(), nullptr);
}

}  // namespace
}  // namespace deltaray
