// Memory for a wide tree.

#ifndef SERVER_TREE_WIDE_BLOCK_H_
#define SERVER_TREE_WIDE_BLOCK_H_

#include <cstddef>
#include <memory>

namespace deltaray {

// One block of bytes, aligned to a cache line, on huge pages where it is large enough and the system has them: rays go
// all over a tree, and pages of 4 KiB would cost a miss of the address cache at most nodes. Not cleared.
class WideBlock {
 public:
  WideBlock() = default;
  // Throws std::bad_alloc.
  explicit WideBlock(size_t bytes);

  std::byte* data() { return bytes_.get(); }
  const std::byte* data() const { return bytes_.get(); }
  size_t size() const { return size_; }

 private:
  struct Free {
    void operator()(std::byte* bytes) const;
  };

  std::unique_ptr<std::byte[], Free> bytes_;
  size_t size_ = 0;
};

}  // namespace deltaray

#endif  // SERVER_TREE_WIDE_BLOCK_H_
