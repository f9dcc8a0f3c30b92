#include "server/build/reference.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <limits>
#include <new>
#include <utility>

#include "server/geometry/triangle_test.h"

namespace deltaray {
namespace {

int64_t Bytes(size_t references) { return static_cast<int64_t>(references * sizeof(Reference)); }

}  // namespace

ReferenceArray::ReferenceArray(size_t capacity, BuildContext& context)
    : data_(static_cast<Reference*>(std::malloc(std::max<size_t>(capacity, 1) * sizeof(Reference)))),
      capacity_(capacity) {
  if (data_ == nullptr) throw std::bad_alloc();
  context_ = &context;
  context_->CountBytes(Bytes(capacity_));
}

ReferenceArray::ReferenceArray(ReferenceArray&& other) noexcept { *this = std::move(other); }

ReferenceArray& ReferenceArray::operator=(ReferenceArray&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(size_, other.size_);
  std::swap(capacity_, other.capacity_);
  std::swap(context_, other.context_);
  return *this;
}

ReferenceArray::~ReferenceArray() {
  if (context_ != nullptr) context_->CountBytes(-Bytes(capacity_));
}

void ReferenceArray::ShrinkToFit() {
  if (size_ == capacity_) return;
  void* const shrunk = std::realloc(data_.get(), std::max<size_t>(size_, 1) * sizeof(Reference));
  if (shrunk == nullptr) return;  // the larger block still stands
  (void)data_.release();
  data_.reset(static_cast<Reference*>(shrunk));
  context_->CountBytes(Bytes(size_) - Bytes(capacity_));
  capacity_ = size_;
}

absl::StatusOr<ReferenceArray> MakeReferences(const TrianglesView& triangles, double duplication_budget,
                                              BuildContext& context) {
  const size_t count = triangles.size();
  // Node and reference indices of a finished tree have 32 bits.
  const double wanted = static_cast<double>(count) * (1 + duplication_budget);
  const double most = std::max(static_cast<double>(count), double{std::numeric_limits<int32_t>::max()});
  ReferenceArray references(static_cast<size_t>(std::min(wanted, most)), context);
  Reference* const data = references.data();

  // Degenerate triangles are marked first and then removed, so that the order does not depend on threads.
  tbb::parallel_for(tbb::blocked_range<size_t>(0, count, 4096), [&](const tbb::blocked_range<size_t>& range) {
    if (context.cancelled()) return;
    const BuildContext::CpuTime time(context);
    for (size_t i = range.begin(); i < range.end(); ++i) {
      const Triangle triangle = triangles[i];
      data[i] = {triangle.GetBounds(), IsDegenerate(triangle) ? kNoPrimitive : static_cast<uint32_t>(i)};
    }
  });
  if (context.cancelled()) return absl::CancelledError("the build was cancelled");
  Reference* const end = std::remove_if(data, data + count, [&](const Reference& reference) {
    return reference.primitive == kNoPrimitive || context.cancelled();
  });
  if (context.cancelled()) return absl::CancelledError("the build was cancelled");
  references.set_size(end - data);
  context.triangles.store(references.size(), std::memory_order_relaxed);
  return references;
}

}  // namespace deltaray
