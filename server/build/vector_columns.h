// Columns of numbers for loops over vector registers.

#ifndef SERVER_BUILD_VECTOR_COLUMNS_H_
#define SERVER_BUILD_VECTOR_COLUMNS_H_

#include <cstddef>
#include <memory>
#include <new>

namespace deltaray {

// kColumns arrays of the same size, each aligned and padded to whole vectors. No allocation for δ-leaves of the usual
// size. Elements are uninitialised.
template <typename T, int kColumns>
class VectorColumns {
 public:
  // Throws std::bad_alloc.
  explicit VectorColumns(size_t size) : padded_size_((size + kPadding - 1) / kPadding * kPadding) {
    if (padded_size_ > kInlineSize) {
      allocated_.reset(static_cast<T*>(::operator new(kColumns* padded_size_ * sizeof(T), kAlignment)));
    }
    data_ = allocated_ ? allocated_.get() : inline_;
  }
  VectorColumns(const VectorColumns&) = delete;
  VectorColumns& operator=(const VectorColumns&) = delete;

  size_t padded_size() const { return padded_size_; }
  T* operator[](int column) { return data_ + column * padded_size_; }
  const T* operator[](int column) const { return data_ + column * padded_size_; }

 private:
  static constexpr std::align_val_t kAlignment{64};
  static constexpr size_t kPadding = 16;  // the widest vector of the machines that there is a build for
  static constexpr size_t kInlineSize = 64;

  struct Free {
    void operator()(T* data) const { ::operator delete(data, kAlignment); }
  };

  const size_t padded_size_;
  std::unique_ptr<T[], Free> allocated_;
  alignas(64) T inline_[kColumns * kInlineSize];
  T* data_;
};

}  // namespace deltaray

#endif  // SERVER_BUILD_VECTOR_COLUMNS_H_
