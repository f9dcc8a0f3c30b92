// The rows of a HitBatch's columns.

#ifndef CLIENT_HIT_COLUMN_H_
#define CLIENT_HIT_COLUMN_H_

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>

namespace deltaray {

static_assert(std::endian::native == std::endian::little, "the wire's numbers are copied as they are");

// The primitive of a ray that hits nothing, and the group of a face that is in none.
inline constexpr uint32_t kNoId = 0xFFFFFFFF;

// REQUIRES: the column has that many rows.
template <typename T>
T RowAt(const std::string& column, size_t row) {
  T value;
  std::memcpy(&value, column.data() + row * sizeof(T), sizeof(T));
  return value;
}

}  // namespace deltaray

#endif  // CLIENT_HIT_COLUMN_H_
