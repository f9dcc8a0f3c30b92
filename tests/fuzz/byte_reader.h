// Takes values off the front of a fuzzer's bytes; past their end all are 0.

#ifndef TESTS_FUZZ_BYTE_READER_H_
#define TESTS_FUZZ_BYTE_READER_H_

#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

namespace deltaray {

class ByteReader {
 public:
  explicit ByteReader(std::span<const uint8_t> bytes) : bytes_(bytes) {}

  bool AtEnd() const { return at_ >= bytes_.size(); }

  uint8_t Byte() { return AtEnd() ? 0 : bytes_[at_++]; }
  // In [0, count). REQUIRES: 0 < count <= 256.
  uint32_t Below(size_t count) { return Byte() % static_cast<uint32_t>(count); }
  // In [-128, 127].
  int Signed() { return static_cast<int8_t>(Byte()); }
  uint32_t Word() {
    uint32_t word = 0;
    for (int i = 0; i < 4; ++i) word |= static_cast<uint32_t>(Byte()) << 8 * i;
    return word;
  }
  // Any bits.
  float Float() { return std::bit_cast<float>(Word()); }

  template <typename T, size_t kCount>
  const T& OneOf(const T (&values)[kCount]) {
    return values[Below(kCount)];
  }

 private:
  std::span<const uint8_t> bytes_;
  size_t at_ = 0;
};

}  // namespace deltaray

#endif  // TESTS_FUZZ_BYTE_READER_H_
