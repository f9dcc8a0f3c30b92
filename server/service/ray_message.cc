#include "server/service/ray_message.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "server/service/message_bytes.h"

namespace deltaray {
namespace {

using Range = RayBatchBytes::Range;

// Wire types of protobuf's encoding.
enum WireType : uint32_t { kVarint = 0, kFixed64 = 1, kBytes = 2, kFixed32 = 5 };

// One field of a message: its number and type, and where its tag and its value lie.
struct Field {
  uint32_t number = 0;
  uint32_t wire_type = 0;
  size_t start = 0;  // of the tag
  Range value;       // without the length in front of kBytes
};

// Reads the fields of a message one by one.
class FieldReader {
 public:
  FieldReader(const MessageSlices& message, Range range)
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
    if (field.wire_type == kVarint) {
      const size_t start = at_;
      if (!Varint()) return std::nullopt;
      field.value = {start, at_ - start};
      return field;
    }
    if (field.wire_type == kBytes) {
      const std::optional<uint64_t> length = Varint();
      if (!length) return std::nullopt;
      size = *length;
    } else if (field.wire_type == kFixed32 || field.wire_type == kFixed64) {
      size = field.wire_type == kFixed32 ? 4 : 8;
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

// Finds the arrays of the v1::RayBatch in `range`. False: protobuf's parser is to look at it.
bool FindArrays(Range range, RayBatchBytes* rays) {
  for (FieldReader reader(rays->message, range); !reader.AtEnd();) {
    const std::optional<Field> field = reader.Next();
    if (!field || field->wire_type != kBytes) return false;
    if (field->number == v1::RayBatch::kRaysFieldNumber) {
      rays->rays = field->value;
    } else if (field->number == v1::RayBatch::kExcludedPrimitiveIdsFieldNumber) {
      rays->excluded_primitive_ids = field->value;
    } else {
      return false;
    }
  }
  return true;
}

// The only field of the number `rays_field` among the fields of a message, and all others.
struct Split {
  std::optional<Field> rays;
  std::string others;
};

// Nothing: protobuf's parser is to look at the message.
std::optional<Split> SplitMessage(const MessageSlices& message, uint32_t rays_field) {
  Split split;
  for (FieldReader reader(message, {0, message.size()}); !reader.AtEnd();) {
    const std::optional<Field> field = reader.Next();
    if (!field) return std::nullopt;
    if (field->number == rays_field) {
      // Two would have to be merged.
      if (split.rays || field->wire_type != kBytes) return std::nullopt;
      split.rays = field;
      continue;
    }
    const size_t size = field->value.offset + field->value.size - field->start;
    std::string scratch(size, '\0');
    split.others.append(message.Read(field->start, size, scratch.data()), size);
  }
  return split;
}

// Parses the forms that every protobuf library writes. False: it is none of these, and nothing was found out.
template <typename Request>
bool ParseQuickly(const grpc::ByteBuffer& bytes, bool rays_alone, Request* request, RayBatchBytes* rays) {
  rays->message = MessageSlices(bytes);
  const std::optional<Split> split = SplitMessage(rays->message, Request::kRaysFieldNumber);
  if (!split || (split->rays && rays_alone && !split->others.empty())) return false;
  if (!request->ParseFromString(split->others)) return false;
  if (!split->rays) return true;
  request->mutable_rays();
  return FindArrays(split->rays->value, rays);
}

template <typename Request>
absl::Status Parse(grpc::ByteBuffer bytes, bool rays_alone, Request* request, RayBatchBytes* rays) {
  if (ParseQuickly(bytes, rays_alone, request, rays)) return absl::OkStatus();
  if (absl::Status status = ParseMessage(std::move(bytes), request); !status.ok()) return status;
  *rays = CopyRayBatch(request->rays());
  if (request->has_rays()) request->mutable_rays()->Clear();
  return absl::OkStatus();
}

}  // namespace

absl::Status ParseRayMessage(grpc::ByteBuffer bytes, v1::CastRaysRequest* request, RayBatchBytes* rays) {
  return Parse(std::move(bytes), /*rays_alone=*/false, request, rays);
}

absl::Status ParseRayMessage(grpc::ByteBuffer bytes, v1::CompareAccuracyRequest* request, RayBatchBytes* rays) {
  return Parse(std::move(bytes), /*rays_alone=*/false, request, rays);
}

absl::Status ParseRayMessage(grpc::ByteBuffer bytes, v1::StreamRaysRequest* request, RayBatchBytes* rays) {
  // Fields of a oneof take each other's place: what the last one is, protobuf tells.
  return Parse(std::move(bytes), /*rays_alone=*/true, request, rays);
}

RayBatchBytes CopyRayBatch(const v1::RayBatch& batch) {
  const std::string& excluded = batch.excluded_primitive_ids();
  return {MessageSlices(grpc::Slice(batch.rays() + excluded)),
          {0, batch.rays().size()},
          {batch.rays().size(), excluded.size()}};
}

}  // namespace deltaray
