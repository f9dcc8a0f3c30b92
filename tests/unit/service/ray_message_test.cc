#include "server/service/ray_message.h"

#include <random>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/sliced_message.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

// What protobuf's own parser makes of `bytes`, and ParseRayMessage, whatever the slices: the same.
template <typename Request>
void ExpectTheSame(const std::string& bytes) {
  Request expected;
  const bool ok = expected.ParseFromString(bytes);
  for (const size_t size : {bytes.size() + 1, size_t{7}, size_t{1}}) {
    Request request;
    RayBatchBytes rays;
    const absl::Status status = ParseRayMessage(InSlices(bytes, size), &request, &rays);
    ASSERT_EQ(status.ok(), ok) << status;
    if (!ok) {
      EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
      EXPECT_THAT(std::string(status.message()), HasSubstr("malformed message"));
      continue;
    }
    EXPECT_EQ(Read(rays.message, rays.rays), expected.rays().rays());
    EXPECT_EQ(Read(rays.message, rays.excluded_primitive_ids), expected.rays().excluded_primitive_ids());
    Request rest = expected;
    if (rest.has_rays()) rest.mutable_rays()->Clear();
    EXPECT_EQ(request.SerializeAsString(), rest.SerializeAsString());
  }
}

v1::RayBatch Batch(size_t rays) {
  v1::RayBatch batch;
  batch.set_rays(std::string(24 * rays, 'r'));
  batch.set_excluded_primitive_ids(std::string(4 * rays, 'x'));
  return batch;
}

v1::CastRaysRequest CastRequest(size_t rays) {
  v1::CastRaysRequest request;
  request.set_mesh("bunny");
  request.mutable_query()->set_t_max(5);
  *request.mutable_rays() = Batch(rays);
  return request;
}

TEST(RayMessageTest, FindsTheRaysOfEachRequest) {
  for (const size_t rays : {0, 1, 5, 6, 1000}) {
    ExpectTheSame<v1::CastRaysRequest>(CastRequest(rays).SerializeAsString());
    v1::StreamRaysRequest request;
    *request.mutable_rays() = Batch(rays);
    ExpectTheSame<v1::StreamRaysRequest>(request.SerializeAsString());
  }
  v1::StreamRaysRequest start;
  start.mutable_start()->set_mesh("bunny");
  ExpectTheSame<v1::StreamRaysRequest>(start.SerializeAsString());
  ExpectTheSame<v1::StreamRaysRequest>("");
  ExpectTheSame<v1::CastRaysRequest>("");
}

TEST(RayMessageTest, RaysAreNotCopied) {
  const std::string bytes = CastRequest(1000).SerializeAsString();
  const grpc::Slice slice(bytes);
  v1::CastRaysRequest request;
  RayBatchBytes rays;
  ASSERT_TRUE(ParseRayMessage(grpc::ByteBuffer(&slice, 1), &request, &rays).ok());
  const char* const first = rays.message.Read(rays.rays.offset, rays.rays.size, nullptr);
  EXPECT_GE(first, reinterpret_cast<const char*>(slice.begin()));
  EXPECT_LT(first, reinterpret_cast<const char*>(slice.end()));
}

TEST(RayMessageTest, UnusualFormsMeanWhatProtobufMakesOfThem) {
  const std::string cast = CastRequest(3).SerializeAsString();
  v1::StreamRaysRequest rays, other_rays, start;
  *rays.mutable_rays() = Batch(2);
  other_rays.mutable_rays()->set_rays("other");
  start.mutable_start()->set_mesh("bunny");
  const std::string r = rays.SerializeAsString(), o = other_rays.SerializeAsString(), s = start.SerializeAsString();
  // Of a oneof the last one counts; equal messages are merged.
  for (const std::string& bytes : {r + o, o + r, s + r, r + s, r + s + o, s + s}) {
    ExpectTheSame<v1::StreamRaysRequest>(bytes);
  }
  ExpectTheSame<v1::CastRaysRequest>(cast + cast);
  // Arrays twice within the batch, in another order, and beside fields that nobody knows.
  for (const std::string& batch : {std::string("\x0a\x02"
                                               "ab"
                                               "\x0a\x01"
                                               "c"),
                                   std::string("\x12\x01"
                                               "x"
                                               "\x0a\x01"
                                               "y"),
                                   std::string("\x0a\x01"
                                               "y"
                                               "\x18\x07"),
                                   std::string("\x0a\x01"
                                               "y"
                                               "\x1a\x01"
                                               "z")}) {
    const std::string length(1, static_cast<char>(batch.size()));
    ExpectTheSame<v1::StreamRaysRequest>("\x12" + length + batch);
    ExpectTheSame<v1::CastRaysRequest>("\x1a" + length + batch);
    ExpectTheSame<v1::CastRaysRequest>("\x1a" + length + batch + "\x0a\x01m" +
                                       "\x7d"
                                       "1234" +
                                       "\x79"
                                       "12345678");
  }
  // A length and a tag in more bytes than needed; a group.
  ExpectTheSame<v1::StreamRaysRequest>(std::string("\x12\x83\x00\x0a\x01y", 6));
  ExpectTheSame<v1::StreamRaysRequest>(std::string("\x92\x00\x03\x0a\x01y", 6));
  ExpectTheSame<v1::StreamRaysRequest>(r + "\x1b\x1c");
  // Text that is no UTF-8.
  ExpectTheSame<v1::CastRaysRequest>(std::string("\x0a\x01\xff", 3) + cast);
}

TEST(RayMessageTest, MuchBesideTheRaysIsRefusedUnread) {
  const std::string rays = CastRequest(100'000).SerializeAsString();
  const auto code = [](const std::string& bytes) {
    v1::CastRaysRequest request;
    RayBatchBytes found;
    return ParseRayMessage(InSlices(bytes, 10'000), &request, &found).code();
  };
  EXPECT_EQ(code(rays), absl::StatusCode::kOk);
  EXPECT_EQ(code(rays + rays), absl::StatusCode::kOk);
  std::string varints, groups;
  for (int i = 0; i < 40'000; ++i) varints += "\x28\x01", groups += "\x7b\x7c";
  for (const std::string& many : {varints, groups}) {
    EXPECT_EQ(code(rays + many), absl::StatusCode::kResourceExhausted);
    EXPECT_EQ(code(many + rays), absl::StatusCode::kResourceExhausted);
    // Within the batch, in one and spread over several.
    const auto in_batch = [](const std::string& fields) {
      v1::CastRaysRequest request;
      EXPECT_TRUE(request.mutable_rays()->ParseFromString(fields));
      return request.SerializeAsString();
    };
    EXPECT_EQ(code(in_batch(many)), absl::StatusCode::kResourceExhausted);
    const std::string half = in_batch(many.substr(0, 40'000));
    EXPECT_EQ(code(half), absl::StatusCode::kOk);
    EXPECT_EQ(code(half + half), absl::StatusCode::kResourceExhausted);
  }
}

TEST(RayMessageTest, DamagedMessagesAreThoseThatProtobufRefuses) {
  const std::string good = CastRequest(20).SerializeAsString();
  for (size_t size = 0; size < good.size(); ++size) ExpectTheSame<v1::CastRaysRequest>(good.substr(0, size));
  std::mt19937 random(5);
  for (int i = 0; i < 3000; ++i) {
    std::string bytes = good;
    // Tags and lengths are at the start, mostly.
    for (int changes = 1 + static_cast<int>(random() % 3); changes > 0; --changes) {
      bytes[random() % 24] = static_cast<char>(random());
    }
    ExpectTheSame<v1::CastRaysRequest>(bytes);
    ExpectTheSame<v1::StreamRaysRequest>(bytes);
  }
}

}  // namespace
}  // namespace deltaray
