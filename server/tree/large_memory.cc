#include "server/tree/large_memory.h"

#include <sys/mman.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <new>

namespace deltaray {
namespace {

constexpr size_t kHugePage = size_t{2} << 20;
constexpr size_t kCacheLine = 64;

size_t RoundUp(size_t bytes, size_t unit) { return (std::max<size_t>(bytes, 1) + unit - 1) / unit * unit; }

// Of these the ones on huge pages. The last page is one where at least half of it is used.
size_t HugeBytes(size_t bytes) { return (bytes + kHugePage / 2) / kHugePage * kHugePage; }

void* MapHugePages(size_t used) {
  const size_t bytes = RoundUp(used, kHugePage), huge = HugeBytes(used);
  // A huge page more, so that one begins within the first.
  void* const mapped = mmap(nullptr, bytes + kHugePage, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (mapped == MAP_FAILED) throw std::bad_alloc();
  auto* const begin = static_cast<std::byte*>(mapped);
  const size_t before = (kHugePage - reinterpret_cast<uintptr_t>(mapped) % kHugePage) % kHugePage;
  if (before != 0) munmap(begin, before);
  munmap(begin + before + bytes, kHugePage - before);
  // Only advice: without huge pages it is slower.
  (void)madvise(begin + before, huge, MADV_HUGEPAGE);
  if (huge != bytes) (void)madvise(begin + before + huge, bytes - huge, MADV_NOHUGEPAGE);
  return begin + before;
}

}  // namespace

void* AllocateLarge(size_t bytes) {
  if (bytes >= kHugePage) return MapHugePages(bytes);
  void* const data = std::aligned_alloc(kCacheLine, RoundUp(bytes, kCacheLine));
  if (data == nullptr) throw std::bad_alloc();
  return data;
}

void* AllocateLargeCleared(size_t bytes) {
  void* const data = AllocateLarge(bytes);
  if (bytes < kHugePage) std::memset(data, 0, bytes);
  return data;
}

size_t ResidentBytes(size_t bytes) { return bytes < kHugePage ? bytes : std::max(bytes, HugeBytes(bytes)); }

void FreeLarge(void* data, size_t bytes) {
  if (bytes >= kHugePage) {
    munmap(data, RoundUp(bytes, kHugePage));
  } else {
    std::free(data);
  }
}

void* ShrinkLarge(void* data, size_t old_bytes, size_t bytes) {
  if (old_bytes < kHugePage) return data;  // too little to move it for
  if (bytes < kHugePage) {
    void* const moved = AllocateLarge(bytes);
    std::copy_n(static_cast<const std::byte*>(data), bytes, static_cast<std::byte*>(moved));
    FreeLarge(data, old_bytes);
    return moved;
  }
  const size_t kept = RoundUp(bytes, kHugePage), all = RoundUp(old_bytes, kHugePage);
  if (kept != all) munmap(static_cast<std::byte*>(data) + kept, all - kept);
  return data;
}

}  // namespace deltaray
