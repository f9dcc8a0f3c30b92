// Memory for large arrays that are written and read in no order.

#ifndef SERVER_TREE_LARGE_MEMORY_H_
#define SERVER_TREE_LARGE_MEMORY_H_

#include <cstddef>
#include <type_traits>
#include <utility>

namespace deltaray {

// Memory that is not cleared, aligned to a cache line. From 2 MiB on it is the system's own, on huge pages where there
// are any: with pages of 4 KiB, each page costs a fault when it is first written, which can take longer than to fill
// it, and each of a ray's nodes a miss of the address cache; and to give them back takes longer than a cancel may.
// malloc would keep what is freed. A last part of less than half a huge page has small ones. Throws std::bad_alloc.
void* AllocateLarge(size_t bytes);
// The same, all bytes 0. From 2 MiB on the system sees to that as pages are first used, so that it takes no time here.
void* AllocateLargeCleared(size_t bytes);
// What so many take of the machine's memory, once all of them have been written: up to half a huge page more.
size_t ResidentBytes(size_t bytes);
// `bytes`: as they were asked for.
void FreeLarge(void* data, size_t bytes);
// Gives back the pages past the first `bytes`. Returns where they are now.
void* ShrinkLarge(void* data, size_t old_bytes, size_t bytes);

// For standard containers.
template <typename T>
struct LargeAllocator {
  using value_type = T;

  LargeAllocator() = default;
  template <typename Other>
  LargeAllocator(const LargeAllocator<Other>&) {}  // NOLINT: converts, as allocators do

  T* allocate(size_t count) { return static_cast<T*>(AllocateLarge(count * sizeof(T))); }
  void deallocate(T* data, size_t count) { FreeLarge(data, count * sizeof(T)); }

  friend bool operator==(const LargeAllocator&, const LargeAllocator&) { return true; }
};

// An array whose elements no constructor runs for.
template <typename T>
class LargeArray {
 public:
  static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);

  LargeArray() = default;
  // Throws std::bad_alloc.
  explicit LargeArray(size_t size) : data_(static_cast<T*>(AllocateLarge(size * sizeof(T)))), size_(size) {}
  // As this, but all bytes are 0.
  static LargeArray Cleared(size_t size) {
    LargeArray array;
    array.data_ = static_cast<T*>(AllocateLargeCleared(size * sizeof(T)));
    array.size_ = size;
    return array;
  }
  LargeArray(LargeArray&& other) noexcept { *this = std::move(other); }
  LargeArray& operator=(LargeArray&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    return *this;
  }
  ~LargeArray() {
    if (data_ != nullptr) FreeLarge(data_, size_ * sizeof(T));
  }

  T* data() { return data_; }
  const T* data() const { return data_; }
  size_t size() const { return size_; }
  T& operator[](size_t i) { return data_[i]; }
  const T& operator[](size_t i) const { return data_[i]; }

  // REQUIRES: size <= size().
  void Shrink(size_t size) {
    data_ = static_cast<T*>(ShrinkLarge(data_, size_ * sizeof(T), size * sizeof(T)));
    size_ = size;
  }

 private:
  T* data_ = nullptr;
  size_t size_ = 0;
};

}  // namespace deltaray

#endif  // SERVER_TREE_LARGE_MEMORY_H_
