#include "server/build/partition.h"

#include <tbb/task_arena.h>

#include <cstring>

#include "gtest/gtest.h"
#include "tests/unit/build/checks.h"

namespace deltaray {
namespace {

std::vector<Reference> Parted(std::vector<Reference> references, float limit, int threads, size_t* left) {
  tbb::task_arena(threads).execute([&] {
    BuildContext context;
    *left = PartitionReferences(
        references, [limit](const Reference& r) { return r.bounds.min.x < limit; }, context);
  });
  return references;
}

// One block, few, and many with a last one that is not full.
TEST(PartitionTest, LeftOnesComeFirstAndNoneIsLost) {
  for (const uint32_t count : {0, 1, 1000, 40'000, 300'001}) {
    const std::vector<Reference> references = RandomReferences(count, count);
    for (const float limit : {-1.0f, 0.01f, 0.5f, 0.9f, 2.0f}) {
      size_t left;
      const std::vector<Reference> parted = Parted(references, limit, 2, &left);
      std::vector<uint8_t> seen(count, 0);
      for (size_t i = 0; i < count; ++i) {
        ASSERT_EQ(parted[i].bounds.min.x < limit, i < left) << i;
        ASSERT_EQ(parted[i].bounds, references[parted[i].primitive].bounds);
        ++seen[parted[i].primitive];
      }
      EXPECT_EQ(std::count(seen.begin(), seen.end(), 1), count);
    }
  }
}

TEST(PartitionTest, SameOrderForAnyNumberOfThreads) {
  const std::vector<Reference> references = RandomReferences(200'000, 7);
  size_t left;
  const std::vector<Reference> one = Parted(references, 0.3f, 1, &left);
  for (const int threads : {2, 3, 8}) {
    const std::vector<Reference> more = Parted(references, 0.3f, threads, &left);
    EXPECT_EQ(std::memcmp(one.data(), more.data(), one.size() * sizeof(Reference)), 0) << threads;
  }
}

}  // namespace
}  // namespace deltaray
