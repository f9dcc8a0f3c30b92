#include "server/tree/large_memory.h"

#include <gtest/gtest.h>
#include <sys/mman.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <new>
#include <numeric>
#include <vector>

namespace deltaray {
namespace {

constexpr size_t kHugePage = size_t{2} << 20;

TEST(LargeMemoryTest, IsAlignedAndCanBeWritten) {
  for (const size_t bytes : {size_t{0}, size_t{1}, size_t{64}, size_t{100}, kHugePage - 1, kHugePage, kHugePage + 1,
                             3 * kHugePage, 3 * kHugePage + 12345}) {
    std::vector<LargeArray<std::byte>> arrays;
    for (int i = 0; i < 3; ++i) {
      LargeArray<std::byte>& array = arrays.emplace_back(bytes);
      ASSERT_EQ(array.size(), bytes);
      EXPECT_EQ(reinterpret_cast<uintptr_t>(array.data()) % (bytes < kHugePage ? 64 : kHugePage), 0u) << bytes;
      std::fill_n(array.data(), bytes, std::byte(i));
    }
    for (int i = 0; i < 3; ++i) {
      const std::byte* const data = arrays[i].data();
      EXPECT_TRUE(std::all_of(data, data + bytes, [i](std::byte x) { return x == std::byte(i); })) << bytes;
    }
  }
}

TEST(LargeMemoryTest, ShrinkingKeepsTheStart) {
  constexpr size_t kPageNumbers = kHugePage / sizeof(uint32_t);
  for (const size_t before : {size_t{1000}, kPageNumbers, 3 * kPageNumbers + 7}) {
    for (const size_t after :
         {size_t{0}, size_t{1}, size_t{999}, kPageNumbers - 1, kPageNumbers, 2 * kPageNumbers + 1}) {
      if (after > before) continue;
      LargeArray<uint32_t> array(before);
      std::iota(array.data(), array.data() + before, 0u);
      array.Shrink(after);
      ASSERT_EQ(array.size(), after);
      for (size_t i = 0; i < after; ++i) ASSERT_EQ(array[i], i) << before << " to " << after;
    }
  }
}

TEST(LargeMemoryTest, IsClearedWhereThatIsAskedFor) {
  for (const size_t bytes : {size_t{1000}, kHugePage - 1, kHugePage + 1, 3 * kHugePage}) {
    for (int i = 0; i < 3; ++i) {
      auto array = LargeArray<std::byte>::Cleared(bytes);
      ASSERT_TRUE(std::all_of(array.data(), array.data() + bytes, [](std::byte x) { return x == std::byte(0); }));
      std::fill_n(array.data(), bytes, std::byte(1));  // for whoever gets this memory next
    }
  }
}

// What nobody asked for would be memory that nobody has counted.
TEST(LargeMemoryTest, TakesAsMuchAsItTells) {
  constexpr size_t kPage = 4096;
  for (const size_t bytes : {kHugePage, kHugePage + 100, 2 * kHugePage - 100, 2 * kHugePage}) {
    LargeArray<std::byte> array(bytes);
    std::fill_n(array.data(), array.size(), std::byte(1));
    std::vector<unsigned char> resident((bytes + kHugePage - 1) / kHugePage * (kHugePage / kPage));
    ASSERT_EQ(mincore(array.data(), resident.size() * kPage, resident.data()), 0);
    const size_t taken = kPage * std::count_if(resident.begin(), resident.end(), [](unsigned char x) { return x & 1; });
    EXPECT_LE(taken, ResidentBytes(bytes) + kPage) << bytes;
    EXPECT_GE(taken, bytes) << bytes;
  }
  EXPECT_EQ(ResidentBytes(1000), 1000u);
  EXPECT_EQ(ResidentBytes(kHugePage + 100), kHugePage + 100);
  EXPECT_EQ(ResidentBytes(2 * kHugePage - 100), 2 * kHugePage);
}

// Whether the system has memory of ours at this huge page.
bool IsMapped(const void* data) {
  std::vector<unsigned char> resident(kHugePage / 4096);
  if (mincore(const_cast<void*>(data), kHugePage, resident.data()) == 0) return true;
  EXPECT_EQ(errno, ENOMEM);
  return false;
}

TEST(LargeMemoryTest, GoesBackToTheSystem) {
  const std::byte* data;
  {
    LargeArray<std::byte> array(4 * kHugePage);
    data = array.data();
    EXPECT_TRUE(IsMapped(data + 3 * kHugePage));
    array.Shrink(2 * kHugePage + 1);
    EXPECT_FALSE(IsMapped(data + 3 * kHugePage));
    EXPECT_TRUE(IsMapped(data + 2 * kHugePage));
    const LargeArray<std::byte> moved = std::move(array);
    EXPECT_EQ(moved.data(), data);
    EXPECT_EQ(array.size(), 0u);  // NOLINT: moved from, and empty by contract
  }
  EXPECT_FALSE(IsMapped(data));
}

TEST(LargeMemoryTest, VectorsGrowInIt) {
  std::vector<uint64_t, LargeAllocator<uint64_t>> numbers;
  for (uint64_t i = 0; i < 1'000'000; ++i) numbers.push_back(i);
  for (uint64_t i = 0; i < numbers.size(); ++i) ASSERT_EQ(numbers[i], i);
  EXPECT_EQ(reinterpret_cast<uintptr_t>(numbers.data()) % kHugePage, 0u);
}

TEST(LargeMemoryTest, MoreThanThereIsThrows) { EXPECT_THROW(AllocateLarge(size_t{1} << 60), std::bad_alloc); }

}  // namespace
}  // namespace deltaray
