// Integers of a size that is known beforehand, for exact arithmetic of which it is known how large it gets.

#ifndef SERVER_GEOMETRY_FIXED_INTEGER_H_
#define SERVER_GEOMETRY_FIXED_INTEGER_H_

#include <algorithm>
#include <array>
#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <compare>
#include <cstdint>

namespace deltaray {

// 64 N bits in two's complement. What does not fit wraps around. Several times as fast as Boost's integers of a fixed
// size, which keep count of their words.
template <int N>
class FixedInteger {
  static_assert(N >= 2);

 public:
  FixedInteger() = default;
  FixedInteger(boost::int128_type value) {  // implicit, as of every integer
    words_.fill(value < 0 ? ~uint64_t{0} : 0);
    words_[0] = static_cast<uint64_t>(value);
    words_[1] = static_cast<uint64_t>(value >> 64);
  }
  // Of a narrower one.
  template <int M>
  explicit FixedInteger(const FixedInteger<M>& value) {
    static_assert(M < N);
    words_.fill(value.IsNegative() ? ~uint64_t{0} : 0);
    std::ranges::copy(value.words(), words_.begin());
  }

  // value * 2^shift. REQUIRES: 0 <= shift < 64 N.
  static FixedInteger Shifted(int32_t value, int shift) {
    FixedInteger shifted = 0;
    const uint64_t magnitude = value < 0 ? -static_cast<uint64_t>(value) : static_cast<uint64_t>(value);
    const int word = shift / 64, bits = shift % 64;
    shifted.words_[word] = magnitude << bits;
    if (bits > 32 && word + 1 < N) shifted.words_[word + 1] = magnitude >> (64 - bits);
    return value < 0 ? -shifted : shifted;
  }

  // The least first.
  const std::array<uint64_t, N>& words() const { return words_; }
  bool IsNegative() const { return static_cast<int64_t>(words_[N - 1]) < 0; }

  // Within 2^-52 of itself. REQUIRES: less than double's range, as all are where N < 16.
  double ToDouble() const {
    const FixedInteger magnitude = IsNegative() ? -*this : *this;
    int top = N - 1;
    while (top > 0 && magnitude.words_[top] == 0) --top;
    const double value = static_cast<double>(magnitude.words_[top]) +
                         (top > 0 ? 0x1p-64 * static_cast<double>(magnitude.words_[top - 1]) : 0);
    return std::ldexp(IsNegative() ? -value : value, 64 * top);
  }

  friend FixedInteger operator+(const FixedInteger& a, const FixedInteger& b) { return Sum(a, b.words_, 0, 0); }
  friend FixedInteger operator-(const FixedInteger& a, const FixedInteger& b) {
    return Sum(a, b.words_, ~uint64_t{0}, 1);
  }
  FixedInteger operator-() const { return FixedInteger(0) - *this; }

  friend FixedInteger operator*(const FixedInteger& a, const FixedInteger& b) {
    FixedInteger product = 0;
    // Carries in registers make 512 bits a third faster.
#pragma GCC unroll 8
    for (int i = 0; i < N; ++i) {
      uint64_t carry = 0;
#pragma GCC unroll 8
      for (int j = 0; i + j < N; ++j) {
        const Wide sum = Wide{a.words_[i]} * b.words_[j] + product.words_[i + j] + carry;
        product.words_[i + j] = static_cast<uint64_t>(sum);
        carry = static_cast<uint64_t>(sum >> 64);
      }
    }
    return product;
  }

  friend bool operator==(const FixedInteger& a, const FixedInteger& b) = default;
  friend std::strong_ordering operator<=>(const FixedInteger& a, const FixedInteger& b) {
    if (a.IsNegative() != b.IsNegative()) return b.IsNegative() <=> a.IsNegative();
    for (int i = N - 1; i > 0; --i) {
      if (a.words_[i] != b.words_[i]) return a.words_[i] <=> b.words_[i];
    }
    return a.words_[0] <=> b.words_[0];
  }

 private:
  using Wide = boost::uint128_type;

  // a + (b ^ flip) + carry.
  static FixedInteger Sum(const FixedInteger& a, const std::array<uint64_t, N>& b, uint64_t flip, uint64_t carry) {
    FixedInteger sum;
    for (int i = 0; i < N; ++i) {
      const Wide wide = Wide{a.words_[i]} + (b[i] ^ flip) + carry;
      sum.words_[i] = static_cast<uint64_t>(wide);
      carry = static_cast<uint64_t>(wide >> 64);
    }
    return sum;
  }

  std::array<uint64_t, N> words_;
};

}  // namespace deltaray

#endif  // SERVER_GEOMETRY_FIXED_INTEGER_H_
