#include "tests/bench/service_client.h"

#include <cstring>
#include <vector>

#include "gtest/gtest.h"

namespace deltaray {
namespace {

std::vector<float> Floats(std::string_view bytes) {
  std::vector<float> floats(bytes.size() / sizeof(float));
  std::memcpy(floats.data(), bytes.data(), bytes.size());
  return floats;
}

TEST(WireRaysTest, IntervalsTravelOnlyWhereOneIsNotTheDefault) {
  std::vector<Ray> rays(2);
  rays[0].origin = {1, 2, 3};
  rays[1].origin = {4, 5, 6};
  rays[1].direction = {7, 8, 9};
  const WireRays without(rays);
  EXPECT_EQ(without.layout, v1::RAY_LAYOUT_FLOAT32X6);
  EXPECT_EQ(without.size(), 2u);
  EXPECT_EQ(Floats(without.Some(1, 1)), (std::vector<float>{4, 5, 6, 7, 8, 9}));

  rays[0].t_max = 10;
  const WireRays with(rays);
  EXPECT_EQ(with.layout, v1::RAY_LAYOUT_FLOAT32X8);
  EXPECT_EQ(with.size(), 2u);
  EXPECT_EQ(Floats(with.Some(0, 1)), (std::vector<float>{1, 2, 3, 0, 0, 0, 0, 10}));
}

}  // namespace
}  // namespace deltaray
