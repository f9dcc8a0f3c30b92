// cast and render, from their command line to what they write, against the fake server.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <csignal>
#include <cstring>
#include <limits>
#include <string>

#include "tests/unit/client/commands_fixture.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

TEST_F(CommandsTest, CastReadsCsvFromStandardInput) {
  session_.SetInput("0,0,5,0,0,-1\n0,0,5,0,0,1\n");
  EXPECT_EQ(session_.Run({"cast", "cube"}), 0);
  EXPECT_EQ(session_.TakeOutput(),
            "ray,t,primitive_id,u,v,hit,back\n"
            "0,5,7,0.25,0.1,1,0\n"
            "1,inf,4294967295,0,0,0,0\n");
  EXPECT_EQ(server_.ray_service.last_start.mesh(), "cube");
  EXPECT_EQ(server_.ray_service.last_start.query().layout(), v1::RAY_LAYOUT_FLOAT64X6);
}

TEST_F(CommandsTest, CastSendsItsQuery) {
  session_.SetInput("0,0,5,0,0,-1\n");
  EXPECT_EQ(session_.Run({"cast", "cube", "-", "--kind", "all", "--columns", "normal,t", "--max-hits", "3", "--cull",
                          "back", "--accuracy", "watertight", "--t-min", "-1.5", "--t-max", "inf", "--wait-final"}),
            0);
  const v1::RayQuery& query = server_.ray_service.last_start.query();
  EXPECT_EQ(query.kind(), v1::QUERY_KIND_ALL_HITS);
  EXPECT_THAT(query.columns(), ElementsAre(v1::HIT_COLUMN_T, v1::HIT_COLUMN_NORMAL));
  EXPECT_EQ(query.max_hits_per_ray(), 3u);
  EXPECT_EQ(query.culling(), v1::CULLING_BACK);
  EXPECT_EQ(query.accuracy(), v1::ACCURACY_LEVEL_WATERTIGHT);
  EXPECT_EQ(query.t_min(), -1.5f);
  EXPECT_EQ(query.t_max(), std::numeric_limits<float>::infinity());
  EXPECT_EQ(query.wait(), v1::BUILD_WAIT_FINAL);
  EXPECT_EQ(session_.TakeOutput(), "ray,t,nx,ny,nz\n0,5,0,0,1\n");
}

TEST_F(CommandsTest, CastStreamsRawRaysInBatches) {
  std::string rays;
  for (int i = 0; i < 10; ++i) {
    const float ray[] = {0, 0, static_cast<float>(i), 0, 0, -1};
    rays.append(reinterpret_cast<const char*>(ray), sizeof(ray));
  }
  const TemporaryFile file(rays);
  EXPECT_EQ(session_.Run({"cast", "cube", file.path(), "--rays-format", "f32x6", "--batch", "4", "--columns", "t",
                          "--format", "raw"}),
            0);
  EXPECT_THAT(server_.ray_service.last_batch_bytes, ElementsAre(4 * 24, 4 * 24, 2 * 24));
  const std::string output = session_.TakeOutput();
  ASSERT_EQ(output.size(), 10 * sizeof(float));
  for (int i = 0; i < 10; ++i) {
    float t;
    std::memcpy(&t, output.data() + i * sizeof(t), sizeof(t));
    EXPECT_EQ(t, i);
  }
}

TEST_F(CommandsTest, CastSendsExcludedTriangles) {
  const uint32_t ids[] = {3, 0xFFFFFFFF, 5};
  const std::string bytes(reinterpret_cast<const char*>(ids), sizeof(ids));
  const std::string rays = "0,0,5,0,0,-1\n0,0,5,0,0,-1\n0,0,5,0,0,-1\n";
  const TemporaryFile exact(bytes);
  session_.SetInput(rays);
  EXPECT_EQ(session_.Run({"cast", "cube", "--exclude", exact.path(), "--kind", "count", "--batch", "2"}), 0);
  EXPECT_EQ(server_.ray_service.last_excluded, bytes);

  const TemporaryFile shorter(bytes.substr(0, 8));
  session_.SetInput(rays);
  EXPECT_EQ(session_.Run({"cast", "cube", "--exclude", shorter.path()}), 1);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr(": ends at the id of ray 2\n"));

  const TemporaryFile longer(bytes + "1234");
  session_.SetInput(rays);
  EXPECT_EQ(session_.Run({"cast", "cube", "--exclude", longer.path()}), 1);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr(": has more ids than there are rays, 3\n"));
}

TEST_F(CommandsTest, CastTellsTheLineOfABadRay) {
  session_.SetInput("0,0,5,0,0,-1\n0,0,5,0,oops,-1\n");
  EXPECT_EQ(session_.Run({"cast", "cube"}), 1);
  EXPECT_EQ(session_.TakeMessages(), "deltaray: standard input: line 2: column dy: 'oops' is not a finite number\n");
}

TEST_F(CommandsTest, CastTellsTheServersError) {
  session_.SetInput("0,0,5,0,0,-1\n");
  EXPECT_EQ(session_.Run({"cast", "missing"}), 69);
  EXPECT_EQ(session_.TakeMessages(), "deltaray: no such mesh: missing (NOT_FOUND)\n");
}

TEST_F(CommandsTest, CastEndsQuietlyWhenNobodyReads) {
  signal(SIGPIPE, SIG_IGN);
  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  close(pipe_ends[0]);
  std::FILE* closed = fdopen(pipe_ends[1], "w");
  std::swap(session_.session().output, closed);
  session_.SetInput("0,0,5,0,0,-1\n");
  EXPECT_EQ(session_.Run({"cast", "cube", "--format", "json"}), 0);
  EXPECT_EQ(session_.TakeMessages(), "");
  std::swap(session_.session().output, closed);
  std::fclose(closed);
}

TEST_F(CommandsTest, CastRefusesContradictoryOptions) {
  EXPECT_EQ(session_.Run({"cast", "cube", "--kind", "any", "--columns", "t"}), 2);
  EXPECT_EQ(session_.Run({"cast", "cube", "--columns", "t,color"}), 2);
  EXPECT_EQ(session_.Run({"cast", "cube", "--max-hits", "3"}), 2);
  EXPECT_EQ(session_.Run({"cast", "cube", "--exclude", "-"}), 2);
  EXPECT_EQ(session_.Run({"cast", "cube", "--batch", "0"}), 2);
  EXPECT_EQ(session_.Run({"cast", "cube", "--batch", "1048577"}), 2);
  EXPECT_EQ(session_.Run({"cast", "cube", "--kind", "nearest"}), 2);
  session_.TakeMessages();
  for (const char* const flag : {"--t-min", "--t-max"}) {
    session_.SetInput("0,0,5,0,0,-1,0,9\n");
    EXPECT_EQ(session_.Run({"cast", "cube", flag, "1"}), 2);
    EXPECT_EQ(session_.TakeMessages(),
              "deltaray: --t-min and --t-max are for rays without t_min and t_max of their own\n");
  }
  session_.SetInput(std::string(32, '\0'));
  EXPECT_EQ(session_.Run({"cast", "cube", "--rays-format", "f32x8", "--t-max", "1"}), 2);
}

// The plane z = 0 fills a picture taken from above it.
TEST_F(CommandsTest, RenderWritesAPicture) {
  AddMesh("plane");
  const TemporaryFile file("");
  EXPECT_EQ(session_.Run({"render", "plane", "-o", file.path(), "--size", "32x16", "--eye", "0,0,4", "--target",
                          "0,0,0", "--batch", "100", "--shade", "normal"}),
            0);
  EXPECT_THAT(session_.TakeMessages(), StartsWith("512 rays, 512 hits, "));
  EXPECT_THAT(file.Read(), StartsWith("\x89PNG\r\n"));
  EXPECT_EQ(server_.ray_service.last_batch_bytes.size(), 6u);
  EXPECT_THAT(server_.ray_service.last_start.query().columns(), ElementsAre(v1::HIT_COLUMN_NORMAL));
  // By id, not by name.
  EXPECT_THAT(server_.ray_service.last_start.mesh(), StartsWith("aaaa"));

  EXPECT_EQ(session_.Run({"render", "plane", "-o", "-", "--shade", "depth"}), 0);
  EXPECT_THAT(session_.TakeOutput(), StartsWith("\x89PNG\r\n"));
  EXPECT_THAT(session_.TakeMessages(), StartsWith("307,200 rays, "));
}

TEST_F(CommandsTest, RenderSendsFloat64WhereTheMeshHasAnOrigin) {
  AddMesh("far");
  EXPECT_EQ(session_.Run({"render", "far", "-o", "/dev/null", "--size", "2x2"}), 0);
  EXPECT_EQ(server_.ray_service.last_start.query().layout(), v1::RAY_LAYOUT_FLOAT32X6);
  server_.mesh_service.Find("far")->mutable_origin()->set_y(5e6);
  EXPECT_EQ(session_.Run({"render", "far", "-o", "/dev/null", "--size", "2x2"}), 0);
  EXPECT_EQ(server_.ray_service.last_start.query().layout(), v1::RAY_LAYOUT_FLOAT64X6);
}

TEST_F(CommandsTest, RenderRefusesBadOptions) {
  AddMesh("cube");
  EXPECT_EQ(session_.Run({"render", "cube"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--size", "640"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--size", "0x5"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--size", "5x20000"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--eye", "1,2"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--eye", "1,2,inf"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--eye", "1e39,0,0"}), 2);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr("stands at 1e+39,0,0, beyond the range of float32"));
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--fov", "180"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--up", "0,0,0"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "/no/such/folder/x.PNG"}), 1);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "/no/such/folder/x.jpg"}), 2);
  EXPECT_EQ(session_.TakeOutput(), "");
}

TEST_F(CommandsTest, NegativeCoordinatesAreNoOptions) {
  AddMesh("cube");
  EXPECT_EQ(
      session_.Run({"render", "cube", "-o", "/dev/null", "--size", "2x2", "--eye", "-1,-2,-3", "--up", "-.5,1,0"}), 0);
}

}  // namespace
}  // namespace deltaray
