#include "server/tree/wide_block.h"

#include <sys/mman.h>

#include <cstdlib>
#include <new>

namespace deltaray {
namespace {

constexpr size_t kHugePage = size_t{2} << 20;
constexpr size_t kCacheLine = 64;

size_t RoundUp(size_t bytes, size_t unit) { return (bytes + unit - 1) / unit * unit; }

}  // namespace

WideBlock::WideBlock(size_t bytes) : size_(bytes) {
  if (bytes == 0) return;
  const size_t alignment = bytes >= kHugePage ? kHugePage : kCacheLine;
  void* const data = std::aligned_alloc(alignment, RoundUp(bytes, alignment));
  if (data == nullptr) throw std::bad_alloc();
  // Without huge pages it is only slower.
  if (alignment == kHugePage) (void)madvise(data, RoundUp(bytes, alignment), MADV_HUGEPAGE);
  bytes_.reset(static_cast<std::byte*>(data));
}

void WideBlock::Free::operator()(std::byte* bytes) const { std::free(bytes); }

}  // namespace deltaray
