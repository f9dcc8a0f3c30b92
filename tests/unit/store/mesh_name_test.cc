#include "server/store/mesh_name.h"

#include <gtest/gtest.h>

#include <string>

#include "server/store/mesh_store.h"

namespace deltaray {
namespace {

TEST(MeshNameTest, TakesUtf8OfUpTo128Bytes) {
  for (const std::string& name : {std::string("a"), std::string("bunny v2/../x"), std::string("Hase \xC3\xA4"),
                                  std::string("\xE5\x85\x94"), std::string("\xF0\x9F\x90\x87"), std::string(128, 'x'),
                                  std::string(63, 'a'), std::string(64, 'A'), std::string(64, 'g'), std::string(".")}) {
    EXPECT_TRUE(ValidateMeshName(name).ok()) << name;
  }
}

TEST(MeshNameTest, RefusesWhatIsNotAName) {
  for (const std::string& name :
       {std::string(), std::string(129, 'x'), std::string("a\nb"), std::string("a\0b", 3), std::string("\x7F"),
        std::string("\xC2\x85"), std::string("\xC2\x9F"), std::string("\xC3"), std::string("\xC0\xAF"),
        std::string("\xED\xA0\x80"), std::string("\xF4\x90\x80\x80"), std::string("\xFF"), std::string(64, 'a'),
        std::string(64, '0')}) {
    EXPECT_EQ(ValidateMeshName(name).code(), absl::StatusCode::kInvalidArgument) << name;
  }
}

TEST(MeshNameTest, TellsIdsFromNames) {
  EXPECT_TRUE(IsMeshId(std::string(64, 'f')));
  EXPECT_FALSE(IsMeshId(std::string(64, 'F')));
  EXPECT_FALSE(IsMeshId(std::string(65, 'f')));
  EXPECT_FALSE(IsMeshId(std::string(63, 'f')));
}

}  // namespace
}  // namespace deltaray
