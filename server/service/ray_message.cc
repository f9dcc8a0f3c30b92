#include "server/service/ray_message.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "server/service/message_bytes.h"

namespace deltaray {
namespace {

// Finds the arrays of the v1::RayBatch in `range`. False: protobuf's parser is to look at it.
bool FindArrays(MessageRange range, RayBatchBytes* rays) {
  for (FieldReader reader(rays->message, range); !reader.AtEnd();) {
    const std::optional<Field> field = reader.Next();
    if (!field || field->wire_type != Field::kBytes) return false;
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
      if (split.rays || field->wire_type != Field::kBytes) return std::nullopt;
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
bool ParseQuickly(bool rays_alone, Request* request, RayBatchBytes* rays) {
  const std::optional<Split> split = SplitMessage(rays->message, Request::kRaysFieldNumber);
  if (!split || (split->rays && rays_alone && !split->others.empty())) return false;
  if (!request->ParseFromString(split->others)) return false;
  if (!split->rays) return true;
  request->mutable_rays();
  return FindArrays(split->rays->value, rays);
}

bool IsArray(const Field& field) {
  return field.number == v1::RayBatch::kRaysFieldNumber ||
         field.number == v1::RayBatch::kExcludedPrimitiveIdsFieldNumber;
}

// Bytes of a message that has v1::RayBatch in fields of the number `rays_field`, beside their arrays.
size_t BytesBesideArrays(const MessageSlices& message, uint32_t rays_field) {
  size_t within = 0;
  const size_t bytes = BytesBeside(message, {0, message.size()}, [&](const Field& field) {
    if (field.number != rays_field) return false;
    if (within <= kMaxSmallMessageBytes) within += BytesBeside(message, field.value, IsArray);
    return true;
  });
  return bytes + within;
}

template <typename Request>
absl::Status Parse(grpc::ByteBuffer bytes, bool rays_alone, Request* request, RayBatchBytes* rays) {
  rays->message = MessageSlices(bytes);
  const size_t others = BytesBesideArrays(rays->message, Request::kRaysFieldNumber);
  if (absl::Status status = CheckSmall(others, request->GetTypeName()); !status.ok()) return status;
  if (ParseQuickly(rays_alone, request, rays)) return absl::OkStatus();
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
