#include "server/service/message_slices.h"

#include <string>
#include <vector>

#include "gtest/gtest.h"

namespace deltaray {
namespace {

TEST(MessageSlicesTest, ReadsAcrossSlices) {
  const std::string bytes = "abcdefghijklmnopqrstuvwxyz";
  // Slices of all lengths, empty ones among them, and long enough ones that gRPC does not keep in the slice itself.
  std::vector<grpc::Slice> slices;
  for (const auto& [first, size] : {std::pair(0, 1), {1, 0}, {1, 2}, {3, 5}, {8, 0}, {8, 18}}) {
    slices.emplace_back(bytes.substr(first, size));
  }
  const MessageSlices message(grpc::ByteBuffer(slices.data(), slices.size()));
  ASSERT_EQ(message.size(), bytes.size());
  for (size_t offset = 0; offset <= bytes.size(); ++offset) {
    for (size_t size = 0; offset + size <= bytes.size(); ++size) {
      char scratch[26];
      EXPECT_EQ(std::string(message.Read(offset, size, scratch), size), bytes.substr(offset, size));
    }
  }
}

TEST(MessageSlicesTest, CopiesNothingThatLiesTogether) {
  const std::string bytes(1000, 'x');
  const grpc::Slice slice(bytes);
  const MessageSlices message{grpc::ByteBuffer(&slice, 1)};
  char scratch[10];
  EXPECT_EQ(message.Read(990, 10, scratch), reinterpret_cast<const char*>(slice.begin()) + 990);
}

TEST(MessageSlicesTest, MayBeEmpty) {
  EXPECT_EQ(MessageSlices().size(), 0u);
  EXPECT_EQ(MessageSlices(grpc::ByteBuffer()).size(), 0u);
}

}  // namespace
}  // namespace deltaray
