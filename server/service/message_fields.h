// The fields of a message as they are encoded, without a parsed copy of it.

#ifndef SERVER_SERVICE_MESSAGE_FIELDS_H_
#define SERVER_SERVICE_MESSAGE_FIELDS_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "server/service/message_bytes.h"
#include "server/service/message_slices.h"

namespace deltaray {

// A part of a message.
struct MessageRange {
  size_t offset = 0;
  size_t size = 0;
};

// One field of a message: its number and type, and where its tag and its value lie.
struct Field {
  // Wire types of protobuf's encoding.
  enum : uint32_t { kVarint = 0, kFixed64 = 1, kBytes = 2, kFixed32 = 5 };

  uint32_t number = 0;
  uint32_t wire_type = 0;
  size_t start = 0;    // of the tag
  MessageRange value;  // without the length in front of kBytes
};

// Reads the fields of a message one by one.
class FieldReader {
 public:
  FieldReader(const MessageSlices& message, MessageRange range)
      : message_(message), at_(range.offset), end_(range.offset + range.size) {}

  bool AtEnd() const { return at_ == end_; }

  // The next field; nothing where the bytes are malformed, or of a kind that protobuf's own parser is to look at.
  std::optional<Field> Next() {
    Field field;
    field.start = at_;
    const std::optional<uint64_t> tag = Varint();
    if (!tag || *tag > UINT32_MAX || *tag >> 3 == 0) return std::nullopt;
    field.number = static_cast<uint32_t>(*tag >> 3);
    field.wire_type = static_cast<uint32_t>(*tag & 7);
    uint64_t size = 0;
    if (field.wire_type == Field::kVarint) {
      const size_t start = at_;
      if (!Varint()) return std::nullopt;
      field.value = {start, at_ - start};
      return field;
    }
    if (field.wire_type == Field::kBytes) {
      const std::optional<uint64_t> length = Varint();
      if (!length) return std::nullopt;
      size = *length;
    } else if (field.wire_type == Field::kFixed32 || field.wire_type == Field::kFixed64) {
      size = field.wire_type == Field::kFixed32 ? 4 : 8;
    } else {
      return std::nullopt;
    }
    if (size > end_ - at_) return std::nullopt;
    field.value = {at_, static_cast<size_t>(size)};
    at_ += field.value.size;
    return field;
  }

 private:
  std::optional<uint64_t> Varint() {
    constexpr size_t kMaxBytes = 10;
    char scratch[kMaxBytes];
    const size_t available = std::min(kMaxBytes, end_ - at_);
    const char* const bytes = message_.Read(at_, available, scratch);
    uint64_t value = 0;
    for (size_t i = 0; i < available; ++i) {
      const auto byte = static_cast<uint8_t>(bytes[i]);
      // The tenth byte holds one bit.
      if (i + 1 == kMaxBytes && byte > 1) return std::nullopt;
      value |= uint64_t{byte & 0x7Fu} << (7 * i);
      if (byte < 0x80) {
        at_ += i + 1;
        return value;
      }
    }
    return std::nullopt;
  }

  const MessageSlices& message_;
  size_t at_;
  const size_t end_;
};

// Bytes in `range` beside the values of those fields of bytes for which is_array(field) holds, or somewhat more than
// kMaxSmallMessageBytes where there are more. What cannot be read counts.
template <typename IsArray>
size_t BytesBeside(const MessageSlices& message, MessageRange range, IsArray&& is_array) {
  size_t bytes = range.size;
  size_t read = 0;
  for (FieldReader reader(message, range); !reader.AtEnd();) {
    const std::optional<Field> field = reader.Next();
    if (!field) break;
    const size_t end = field->value.offset + field->value.size;
    const bool array = field->wire_type == Field::kBytes && is_array(*field);
    if (array) bytes -= field->value.size;
    read += end - field->start - (array ? field->value.size : 0);
    if (read > kMaxSmallMessageBytes) return read;
  }
  return bytes;
}

}  // namespace deltaray

#endif  // SERVER_SERVICE_MESSAGE_FIELDS_H_
