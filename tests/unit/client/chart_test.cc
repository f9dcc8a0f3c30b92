// The command `chart`, against the fake server, and the parts that only it has.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "client/accuracy_chart.h"
#include "client/accuracy_text.h"
#include "tests/unit/client/fake_server.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

using ::testing::ContainsRegex;
using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

class ChartTest : public ::testing::Test {
 protected:
  ChartTest() : session_(server_.address()) {
    session_.SetInput("v");
    EXPECT_EQ(session_.Run({"upload", "-", "--name", "plane"}), 0);
    session_.TakeOutput();
    session_.TakeMessages();
  }

  const v1::CompareAccuracyRequest& request() const { return server_.ray_service.last_comparison; }

  // The rays that were sent, six numbers each.
  std::vector<std::array<double, 6>> Rays() const {
    std::vector<std::array<double, 6>> rays(request().rays().rays().size() / sizeof(std::array<double, 6>));
    std::memcpy(rays.data(), request().rays().rays().data(), request().rays().rays().size());
    return rays;
  }

  FakeServer server_;
  TestSession session_;
  const TemporaryFile svg_{""};
};

TEST_F(ChartTest, WritesPictureTableAndChoice) {
  const TemporaryFile csv("");
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--csv", csv.path(), "--count", "1000", "--rounds", "3",
                          "--cull", "back"}),
            0);
  EXPECT_THAT(svg_.Read(), StartsWith("<svg xmlns=\"http://www.w3.org/2000/svg\""));
  EXPECT_THAT(svg_.Read(), HasSubstr("Speed against accuracy: plane, 1,000 bounce rays<"));
  EXPECT_THAT(svg_.Read(), HasSubstr(">fast: 100.0 ns<"));
  EXPECT_THAT(svg_.Read(), HasSubstr(">12,345 ulp<"));
  const std::string text = session_.TakeOutput();
  EXPECT_THAT(text, HasSubstr("memory  nodes 3.0 MiB, references 0 B, mesh 0 B\n"));
  EXPECT_THAT(text, HasSubstr("\nfast           100.0    10.00               3000             2           1"));
  EXPECT_THAT(text, HasSubstr("cheapest level with at most 0 wrong answers per million: exact (never wrong: the others "
                              "are measured by it)\n"));
  EXPECT_THAT(csv.Read(),
              StartsWith("ray_count,hit_count,accuracy,answered_accuracy,false_misses,false_hits,wrong_primitives,"));
  EXPECT_THAT(csv.Read(), ContainsRegex("\n1000,[0-9]+,fast,fast,2,1,0,12345,0,0,100\n"));
  // By id, not by name.
  EXPECT_THAT(request().mesh(), StartsWith("aaaa"));
  EXPECT_EQ(request().rounds(), 3u);
  EXPECT_EQ(request().query().culling(), v1::CULLING_BACK);
  EXPECT_EQ(request().query().layout(), v1::RAY_LAYOUT_FLOAT64X6);
}

TEST_F(ChartTest, ChoosesTheCheapestLevelThatIsGoodEnough) {
  const auto choice = [this](const std::string& most) {
    EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--count", "1000", "--max-wrong-per-million", most,
                            "--format", "json"}),
              0);
    EXPECT_THAT(session_.TakeOutput(), HasSubstr("\"ray_count\":\"1000\""));
    return session_.TakeMessages();
  };
  EXPECT_THAT(choice("999"), HasSubstr("per million: exact ("));
  EXPECT_THAT(choice("1000"), HasSubstr("per million: watertight (1 wrong of 1,000 rays)\n"));
  EXPECT_THAT(choice("3000"), HasSubstr("per million: fast (3 wrong of 1,000 rays)\n"));
}

TEST_F(ChartTest, SendsTheRaysOfAFile) {
  session_.SetInput("1,2,3,0,0,-1\n4,5,6,0,0,1\n");
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--rays", "-", "--kind", "any", "--format", "csv"}), 0);
  EXPECT_EQ(Rays(), (std::vector<std::array<double, 6>>{{1, 2, 3, 0, 0, -1}, {4, 5, 6, 0, 0, 1}}));
  EXPECT_EQ(request().query().kind(), v1::QUERY_KIND_ANY_HIT);
  EXPECT_THAT(session_.TakeOutput(), StartsWith("ray_count,hit_count,accuracy,"));
}

// 2^20 rays of 64 bytes are as many bytes as a message may have, which leaves none for the query.
TEST_F(ChartTest, RefusesMoreLargeRaysThanAMessageHolds) {
  const TemporaryFile rays("");
  std::filesystem::resize_file(rays.path(), size_t{1 << 20} * 64);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--rays", rays.path(), "--rays-format", "f64x8"}), 1);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr(": has more than 1,048,560 rays of 64 bytes, the most of a batch\n"));
}

TEST_F(ChartTest, BouncesStartOnTheMeshAndLeaveIt) {
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--count", "500", "--seed", "9"}), 0);
  const auto rays = Rays();
  ASSERT_EQ(rays.size(), 500u);
  for (const auto& ray : rays) {
    EXPECT_NEAR(ray[2], 0, 1e-5);
    EXPECT_GE(ray[5], 0);
  }
  std::string excluded;
  for (int i = 0; i < 500; ++i) excluded.append("\7\0\0\0", 4);
  EXPECT_EQ(request().rays().excluded_primitive_ids(), excluded);
  // The same seed, the same rays; another, others.
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--count", "500", "--seed", "9"}), 0);
  EXPECT_EQ(Rays(), rays);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--count", "500", "--seed", "8"}), 0);
  EXPECT_NE(Rays(), rays);
}

TEST_F(ChartTest, ShadowsEndAtOneLight) {
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--count", "50", "--generate", "shadow"}), 0);
  const auto rays = Rays();
  ASSERT_EQ(rays.size(), 50u);
  EXPECT_EQ(request().query().t_max(), 1);
  for (const auto& ray : rays) {
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(ray[axis] + ray[axis + 3], rays[0][axis] + rays[0][axis + 3], 1e-9);
    }
  }
}

TEST_F(ChartTest, ShadowsMayEndBeforeTheLight) {
  for (const auto& [given, sent] : {std::pair("0.25", 0.25f), std::pair("7", 1.0f)}) {
    EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--generate", "shadow", "--t-max", given}), 0);
    EXPECT_EQ(request().query().t_max(), sent);
  }
}

TEST_F(ChartTest, ChordsCrossTheSphereAboutTheMesh) {
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--count", "50", "--generate", "chords"}), 0);
  const auto rays = Rays();
  ASSERT_EQ(rays.size(), 50u);
  for (const auto& ray : rays) {
    EXPECT_NEAR(std::hypot(ray[0], ray[1], ray[2]), std::sqrt(2), 1e-9);
    EXPECT_NEAR(std::hypot(ray[0] + ray[3], ray[1] + ray[4], ray[2] + ray[5]), std::sqrt(2), 1e-9);
  }
}

TEST_F(ChartTest, CameraRaysHaveOneOrigin) {
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--count", "7", "--generate", "camera"}), 0);
  const auto rays = Rays();
  ASSERT_EQ(rays.size(), 7u);
  EXPECT_EQ(rays[0][0], rays[6][0]);
  EXPECT_EQ(request().rays().excluded_primitive_ids(), "");
}

TEST_F(ChartTest, RefusesBadOptionsAndFiles) {
  EXPECT_EQ(session_.Run({"chart", "plane"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--rays", "-", "--generate", "camera"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--generate", "sun"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--count", "0"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--kind", "all"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--rounds", "33"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--max-wrong-per-million", "-1"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--max-wrong-per-million", "inf"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--seed", "-1"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--t-max", "nan"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--csv", ""}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--csv", svg_.path()}), 2);
  const std::filesystem::path svg(svg_.path());
  const std::string spelt = (svg.parent_path() / "." / svg.filename()).string();
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--csv", spelt}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", ""}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", "/dev/stdout"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", "-"}), 2);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--csv", "-"}), 2);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr("--csv: the measurements go to standard output; name a file"));
  EXPECT_EQ(session_.Run({"chart", "missing", "-o", svg_.path()}), 69);
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", "/no/such/folder/x.svg"}), 1);
  session_.TakeMessages();
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", "/no/such/folder/x.png"}), 2);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr("must end in .svg"));
  session_.SetInput("0,0,5,0,0,-1,0,9\n");
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--rays", "-", "--t-max", "1"}), 2);
  session_.SetInput("");
  EXPECT_EQ(session_.Run({"chart", "plane", "-o", svg_.path(), "--rays", "-"}), 1);
  EXPECT_EQ(svg_.Read(), "");
}

TEST(AccuracyTextTest, TellsWhatSoManyRaysCanShow) {
  v1::CompareAccuracyResponse comparison;
  comparison.add_levels()->set_accuracy(v1::ACCURACY_LEVEL_FAST);
  comparison.mutable_levels(0)->set_answered_accuracy(v1::ACCURACY_LEVEL_FAST);
  const auto choice = [&](uint64_t rays) {
    comparison.set_ray_count(rays);
    return CheapestLevelText(comparison, 0);
  };
  EXPECT_EQ(choice(100'000),
            "cheapest level with at most 0 wrong answers per million: fast (none wrong of 100,000 rays, which shows "
            "fewer than 30 per million with 95 % confidence)");
  EXPECT_THAT(choice(1 << 20), HasSubstr("of 1,048,576 rays, which shows fewer than 2.9 per million"));
  EXPECT_THAT(choice(1000), HasSubstr("fewer than 3,000 per million"));
  EXPECT_THAT(choice(70), HasSubstr("fewer than 42,858 per million"));
  EXPECT_THAT(choice(3), EndsWith("fast (none wrong of 3 rays, which are too few to show anything)"));
}

TEST(AccuracyChartTest, WrapsALongFooter) {
  v1::CompareAccuracyResponse comparison;
  comparison.set_ray_count(10);
  comparison.add_levels()->set_nanoseconds_per_ray(0.5);
  const std::string half(70, 'x');
  const std::string svg = AccuracyChartSvg("title", half + " " + half, comparison);
  EXPECT_THAT(svg, HasSubstr("y=\"538.0\" text-anchor=\"start\" fill=\"#202020\">" + half + "<"));
  EXPECT_THAT(svg, HasSubstr("y=\"556.0\" text-anchor=\"start\" fill=\"#202020\">" + half + "<"));
}

TEST(AccuracyChartTest, TakesAnyTitleAndLevelsThatAreNeverWrong) {
  v1::CompareAccuracyResponse comparison;
  comparison.set_ray_count(10);
  comparison.add_levels()->set_nanoseconds_per_ray(0.5);
  const std::string svg = AccuracyChartSvg("<&\"\033>", "end", comparison);
  EXPECT_THAT(svg, HasSubstr(">&lt;&amp;&quot;?&gt;<"));
  EXPECT_THAT(svg, Not(HasSubstr("\"nan")));
  EXPECT_THAT(svg, Not(HasSubstr("\"inf")));
}

}  // namespace
}  // namespace deltaray
