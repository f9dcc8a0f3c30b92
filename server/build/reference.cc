#include "server/build/reference.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "server/geometry/triangle_test.h"

namespace deltaray {
namespace {

constexpr size_t kBlockReferences = 4096;

int64_t Bytes(size_t references) { return static_cast<int64_t>(references * sizeof(Reference)); }

}  // namespace

ReferenceArray::ReferenceArray(size_t capacity, BuildContext& context) : data_(capacity), context_(&context) {
  context_->CountBytes(Bytes(capacity));
}

ReferenceArray::ReferenceArray(ReferenceArray&& other) noexcept { *this = std::move(other); }

ReferenceArray& ReferenceArray::operator=(ReferenceArray&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(size_, other.size_);
  std::swap(context_, other.context_);
  return *this;
}

ReferenceArray::~ReferenceArray() {
  if (context_ != nullptr) context_->CountBytes(-Bytes(capacity()));
}

void ReferenceArray::ShrinkToFit() {
  if (size_ == capacity()) return;
  const int64_t given_back = Bytes(capacity()) - Bytes(size_);
  data_.Shrink(size_);  // may throw
  context_->CountBytes(-given_back);
}

absl::StatusOr<ReferenceArray> MakeReferences(const TrianglesView& triangles, double duplication_budget,
                                              BuildContext& context) {
  const size_t count = triangles.size();
  // Node and reference indices of a finished tree have 32 bits.
  const double wanted = static_cast<double>(count) * (1 + duplication_budget);
  const double most = std::max(static_cast<double>(count), double{std::numeric_limits<int32_t>::max()});
  ReferenceArray references(static_cast<size_t>(std::min(wanted, most)), context);
  Reference* const data = references.data();

  // 1. Each block puts those of its triangles that are not degenerate together.
  const size_t blocks = (count + kBlockReferences - 1) / kBlockReferences;
  std::vector<size_t> sizes(blocks);
  tbb::parallel_for(tbb::blocked_range<size_t>(0, blocks), [&](const tbb::blocked_range<size_t>& range) {
    const BuildContext::CpuTime time(context);
    for (size_t block = range.begin(); block < range.end() && !context.cancelled(); ++block) {
      const size_t begin = block * kBlockReferences, end = std::min(begin + kBlockReferences, count);
      size_t size = 0;
      for (size_t i = begin; i < end; ++i) {
        const Triangle triangle = triangles[i];
        if (!IsDegenerate(triangle)) data[begin + size++] = {triangle.GetBounds(), static_cast<uint32_t>(i)};
      }
      sizes[block] = size;
    }
  });

  // 2. The blocks move together.
  size_t size = 0;
  for (size_t block = 0; block < blocks && !context.cancelled(); ++block) {
    const Reference* const begin = data + block * kBlockReferences;
    if (begin != data + size) std::copy(begin, begin + sizes[block], data + size);
    size += sizes[block];
  }
  if (context.cancelled()) return absl::CancelledError("the build was cancelled");
  references.set_size(size);
  context.triangles.store(references.size(), std::memory_order_relaxed);
  return references;
}

}  // namespace deltaray
