// Every command, from its command line to what it writes, against the fake server.

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openssl/sha.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <thread>

#include "tests/unit/client/fake_server.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::StartsWith;

class CommandsTest : public ::testing::Test {
 protected:
  CommandsTest() : session_(server_.address()) {}

  // Puts a mesh of bounds -1 to 1 on the server.
  std::string AddMesh(const std::string& name) {
    TestSession session(server_.address());
    session.SetInput("v");
    EXPECT_EQ(session.Run({"upload", "-", "--name", name}), 0);
    std::string id = session.TakeOutput();
    id.pop_back();
    return id;
  }

  FakeServer server_;
  TestSession session_;
};

TEST_F(CommandsTest, UploadSendsSizeChecksumAndOptions) {
  const std::string bytes(3'000'000, 'x');
  const TemporaryFile file(bytes);
  EXPECT_EQ(session_.Run({"upload", file.path(), "--name", "cube", "--format", "obj", "--preset", "best", "--builder",
                          "kd_tree", "--delta", "64", "--alpha", "0.25", "--lazy"}),
            0);
  EXPECT_THAT(session_.TakeOutput(), MatchesRegex("a{63}0\n"));
  EXPECT_THAT(session_.TakeMessages(), HasSubstr(": stored, 0 vertices, 1,234,567 triangles\n"
                                                 "warning: a face was ?[31mred\n"));
  EXPECT_EQ(server_.mesh_service.last_upload, bytes);
  const v1::UploadHeader& header = server_.mesh_service.last_header;
  EXPECT_EQ(header.name(), "cube");
  EXPECT_EQ(header.format(), v1::MESH_FORMAT_OBJ);
  EXPECT_EQ(header.size_bytes(), bytes.size());
  unsigned char digest[SHA256_DIGEST_LENGTH];
  SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), digest);
  EXPECT_EQ(header.sha256(), std::string(reinterpret_cast<char*>(digest), sizeof(digest)));
  EXPECT_EQ(header.build_options().preset(), v1::BUILD_PRESET_BEST);
  EXPECT_EQ(header.build_options().builder(), v1::TREE_BUILDER_KD_TREE);
  EXPECT_EQ(header.build_options().delta(), 64u);
  EXPECT_EQ(header.build_options().alpha(), 0.25);
  EXPECT_TRUE(header.build_options().lazy());
  EXPECT_FALSE(header.build_options().has_traversal_cost());
  EXPECT_FALSE(header.has_raw_layout());
}

// Else the server would take them for new options of a mesh that it has, and build its tree anew.
TEST_F(CommandsTest, UploadHasBuildOptionsOnlyWhereOneIsGiven) {
  session_.SetInput("v");
  EXPECT_EQ(session_.Run({"upload", "-", "--name", "cube"}), 0);
  EXPECT_FALSE(server_.mesh_service.last_header.has_build_options());
  session_.SetInput("v");
  EXPECT_EQ(session_.Run({"upload", "-", "--alpha", "0"}), 0);
  ASSERT_TRUE(server_.mesh_service.last_header.has_build_options());
  EXPECT_TRUE(server_.mesh_service.last_header.build_options().has_alpha());
}

TEST_F(CommandsTest, UploadFromStandardInputHasNoSize) {
  session_.SetInput("v 0 0 0\n");
  EXPECT_EQ(session_.Run({"upload", "-"}), 0);
  EXPECT_EQ(server_.mesh_service.last_upload, "v 0 0 0\n");
  EXPECT_FALSE(server_.mesh_service.last_header.has_size_bytes());
  EXPECT_EQ(server_.mesh_service.last_header.sha256(), "");
}

TEST_F(CommandsTest, UploadOfRawArrays) {
  session_.SetInput("bytes");
  EXPECT_EQ(session_.Run({"upload", "-", "--format", "raw", "--vertices", "5000000000", "--triangles", "2",
                          "--positions", "float64"}),
            0);
  const v1::RawLayout& layout = server_.mesh_service.last_header.raw_layout();
  EXPECT_EQ(layout.vertex_count(), 5000000000u);
  EXPECT_EQ(layout.triangle_count(), 2u);
  EXPECT_EQ(layout.position_type(), v1::SCALAR_TYPE_FLOAT64);

  EXPECT_EQ(session_.Run({"upload", "-", "--format", "raw"}), 2);
  EXPECT_EQ(session_.Run({"upload", "-", "--vertices", "1", "--triangles", "1"}), 2);
  EXPECT_EQ(session_.Run({"upload", "-", "--format", "raw", "--vertices", "1"}), 2);
  for (const char* const count : {"-1", "18446744073709551616", "1.5", "0x10", ""}) {
    EXPECT_EQ(session_.Run({"upload", "-", "--format", "raw", "--vertices", count, "--triangles", "1"}), 2) << count;
  }
}

TEST_F(CommandsTest, UploadThatWaitsFailsWithTheBuild) {
  session_.SetInput("v");
  EXPECT_EQ(session_.Run({"upload", "-", "--wait"}), 0);
  server_.behaviour.final_state = v1::MESH_STATE_FAILED;
  session_.TakeMessages();
  EXPECT_EQ(session_.Run({"upload", "-", "--wait"}), 1);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr("deltaray: the build failed: out of memory\n"));
}

TEST_F(CommandsTest, UploadPrintsTheIdWhereNoRemarkCanBeWritten) {
  std::FILE* full = std::fopen("/dev/full", "w");
  std::swap(session_.session().messages, full);
  session_.SetInput("v");
  EXPECT_EQ(session_.Run({"upload", "-"}), 1);
  EXPECT_THAT(session_.TakeOutput(), MatchesRegex("a{63}0\n"));
  std::swap(session_.session().messages, full);
  std::fclose(full);
}

TEST_F(CommandsTest, RefusedUploadTellsTheServersText) {
  server_.behaviour.upload_status = grpc::Status(grpc::StatusCode::RESOURCE_EXHAUSTED, "over 1 MiB");
  const TemporaryFile file(std::string(20'000'000, 'x'));
  EXPECT_EQ(session_.Run({"upload", file.path()}), 64 + 8);
  EXPECT_EQ(session_.TakeMessages(), "deltaray: over 1 MiB (RESOURCE_EXHAUSTED)\n");
  EXPECT_EQ(session_.TakeOutput(), "");
}

TEST_F(CommandsTest, StoppedUploadIsCancelled) {
  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  session_.SetInputFd(pipe_ends[0]);
  std::thread stopper([&] {
    const std::string half(1 << 16, 'x');
    EXPECT_EQ(write(pipe_ends[1], half.data(), half.size()), static_cast<ssize_t>(half.size()));
    session_.stop.Fire();
  });
  EXPECT_EQ(session_.Run({"upload", "-"}), 65);
  stopper.join();
  close(pipe_ends[1]);
  EXPECT_EQ(session_.TakeMessages(), "deltaray: interrupted (CANCELLED)\n");
  TestSession other(server_.address());
  EXPECT_EQ(other.Run({"list"}), 0);
  EXPECT_EQ(other.TakeOutput(), "");
}

TEST_F(CommandsTest, UploadOfNothing) {
  EXPECT_EQ(session_.Run({"upload", "/no/such/file"}), 1);
  EXPECT_EQ(session_.TakeMessages(), "deltaray: cannot open /no/such/file: No such file or directory\n");
}

TEST_F(CommandsTest, ListFollowsPages) {
  for (int i = 0; i < 5; ++i) AddMesh("mesh" + std::to_string(i));
  EXPECT_EQ(session_.Run({"list", "--format", "csv"}), 0);
  const std::string csv = session_.TakeOutput();
  EXPECT_THAT(csv, StartsWith("id,names,vertex_count,"));
  for (int i = 0; i < 5; ++i) EXPECT_THAT(csv, HasSubstr("aaa" + std::to_string(i) + ",mesh" + std::to_string(i)));
  EXPECT_EQ(session_.Run({"list", "--format", "json"}), 0);
  const std::string json = session_.TakeOutput();
  EXPECT_EQ(std::count(json.begin(), json.end(), '\n'), 5);
  EXPECT_EQ(session_.Run({"list"}), 0);
  const std::string table = session_.TakeOutput();
  EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 6);
  EXPECT_THAT(table, StartsWith("NAMES"));
}

TEST_F(CommandsTest, ShowTellsAllAboutAMesh) {
  AddMesh("cube");
  EXPECT_EQ(session_.Run({"show", "cube"}), 0);
  const std::string text = session_.TakeOutput();
  EXPECT_THAT(text, HasSubstr("triangles      1,234,567\n"));
  EXPECT_THAT(text, HasSubstr("bounds         -1 -1 0  to  1 1 0\n"));
  EXPECT_THAT(text, HasSubstr("state          building\n"));
  EXPECT_THAT(text, HasSubstr("warnings       a face was ?[31mred\n"));
  EXPECT_EQ(session_.Run({"show", "cube", "--format", "json"}), 0);
  EXPECT_THAT(session_.TakeOutput(), HasSubstr("\"triangle_count\":\"1234567\""));
  EXPECT_EQ(session_.Run({"show", "other"}), 69);
  EXPECT_EQ(session_.TakeMessages(), "deltaray: no such mesh: other (NOT_FOUND)\n");
}

TEST_F(CommandsTest, NameMovesAndGoes) {
  const std::string first = AddMesh("current");
  const std::string second = AddMesh("");
  EXPECT_EQ(session_.Run({"name", "current", second}), 0);
  EXPECT_EQ(session_.TakeOutput(), first + "\n");
  EXPECT_EQ(session_.Run({"name", "--remove", "current"}), 0);
  EXPECT_EQ(session_.TakeOutput(), second + "\n");
  EXPECT_EQ(session_.Run({"name", "current", "missing"}), 69);
  EXPECT_EQ(session_.Run({"name", "current"}), 2);
  EXPECT_EQ(session_.Run({"name", "--remove", "current", second}), 2);
}

TEST_F(CommandsTest, DeletePrintsTheId) {
  const std::string id = AddMesh("cube");
  EXPECT_EQ(session_.Run({"delete", "cube"}), 0);
  EXPECT_EQ(session_.TakeOutput(), id + "\n");
  EXPECT_EQ(session_.Run({"delete", "cube"}), 69);
}

TEST_F(CommandsTest, WatchFollowsToTheEnd) {
  AddMesh("cube");
  EXPECT_EQ(session_.Run({"watch", "cube"}), 0);
  EXPECT_EQ(session_.TakeOutput(), "ready: build 3, 1,000 triangles, 40 of 40 δ-leaves, 0.000 s\n");
  EXPECT_EQ(session_.TakeMessages(), "");
  EXPECT_EQ(session_.Run({"watch", "cube", "--format", "json"}), 0);
  const std::string json = session_.TakeOutput();
  EXPECT_EQ(std::count(json.begin(), json.end(), '\n'), 3);
  EXPECT_EQ(session_.Run({"watch", "cube", "--format", "csv"}), 0);
  EXPECT_THAT(session_.TakeOutput(), MatchesRegex("id,progress.state.*\ncube,building.*\ncube,provisional.*\n"
                                                  "cube,ready,3,done,500,1000,40,40,0,\n"));
  server_.behaviour.final_state = v1::MESH_STATE_FAILED;
  EXPECT_EQ(session_.Run({"watch", "cube"}), 1);
  EXPECT_EQ(session_.Run({"watch", "other"}), 69);
}

TEST_F(CommandsTest, WatchDrawsABarOnATerminal) {
  AddMesh("cube");
  session_.session().show_progress = true;
  EXPECT_EQ(session_.Run({"watch", "cube"}), 0);
  EXPECT_THAT(session_.TakeMessages(), HasSubstr(" 25 %  top: 500 references placed, 1,000 triangles"));
}

TEST_F(CommandsTest, StatsInEveryFormat) {
  AddMesh("cube");
  EXPECT_EQ(session_.Run({"stats", "cube"}), 0);
  const std::string text = session_.TakeOutput();
  EXPECT_THAT(text, HasSubstr("references      1,100 (1.100 a triangle)\n"));
  EXPECT_THAT(text, HasSubstr("SAH cost        12.500\n"));
  EXPECT_THAT(text, HasSubstr("rays after      0.125 s, first answered after -\n"));
  EXPECT_THAT(text, HasSubstr("top    0.250 s  0.000 s\n"));
  EXPECT_THAT(text, HasSubstr("2-3     4,321\n"));
  EXPECT_THAT(text, HasSubstr("chosen          eager: why not\n"));
  EXPECT_EQ(session_.Run({"stats", "cube", "--format", "json"}), 0);
  EXPECT_THAT(session_.TakeOutput(), HasSubstr("\"sah_cost\":12.5"));
  EXPECT_EQ(session_.Run({"stats", "cube", "--format", "csv"}), 0);
  EXPECT_THAT(session_.TakeOutput(), MatchesRegex("id,.*stats.sah_cost.*\n.*,12.5,.*\n"));
  AddMesh("unbuilt");
  EXPECT_EQ(session_.Run({"stats", "unbuilt"}), 64 + 9);
}

TEST_F(CommandsTest, RebuildSendsOptions) {
  const std::string id = AddMesh("cube");
  EXPECT_EQ(session_.Run({"rebuild", "cube", "--builder", "tang2015", "--traversal-cost", "2", "--wait"}), 0);
  EXPECT_EQ(session_.TakeOutput(), id + "\n");
  EXPECT_EQ(server_.mesh_service.last_rebuild.mesh(), "cube");
  EXPECT_EQ(server_.mesh_service.last_rebuild.build_options().builder(), v1::TREE_BUILDER_TANG2015);
  EXPECT_EQ(server_.mesh_service.last_rebuild.build_options().traversal_cost(), 2);
  EXPECT_EQ(session_.Run({"rebuild", "cube"}), 0);
  EXPECT_FALSE(server_.mesh_service.last_rebuild.has_build_options());
  EXPECT_EQ(session_.Run({"rebuild", "cube", "--lazy=false"}), 0);
  EXPECT_TRUE(server_.mesh_service.last_rebuild.build_options().has_lazy());
  EXPECT_FALSE(server_.mesh_service.last_rebuild.build_options().lazy());
}

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
  EXPECT_THAT(session_.TakeMessages(), testing::HasSubstr("stands at 1e+39,0,0, beyond the range of float32"));
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--fov", "180"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "-", "--up", "0,0,0"}), 2);
  EXPECT_EQ(session_.Run({"render", "cube", "-o", "/no/such/folder/x.png"}), 1);
  EXPECT_EQ(session_.TakeOutput(), "");
}

TEST_F(CommandsTest, NegativeCoordinatesAreNoOptions) {
  AddMesh("cube");
  EXPECT_EQ(
      session_.Run({"render", "cube", "-o", "/dev/null", "--size", "2x2", "--eye", "-1,-2,-3", "--up", "-.5,1,0"}), 0);
}

}  // namespace
}  // namespace deltaray
