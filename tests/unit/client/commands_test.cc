// The commands about meshes, from their command line to what they write, against the fake server.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openssl/sha.h>
#include <unistd.h>

#include <algorithm>
#include <string>
#include <thread>

#include "tests/unit/client/commands_fixture.h"

namespace deltaray {
namespace {

using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::Not;
using ::testing::StartsWith;

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

TEST_F(CommandsTest, ListEndsWhereAPageComesAgain) {
  AddMesh("cube");
  server_.behaviour.page_token = "again";
  for (const char* const format : {"table", "json", "csv"}) {
    EXPECT_EQ(session_.Run({"list", "--format", format}), 1);
    EXPECT_EQ(session_.TakeMessages(),
              "deltaray: the server's answer has the token of a page that was there already\n");
  }
}

TEST_F(CommandsTest, AnswersWithoutAnIdAreRefused) {
  AddMesh("cube");
  server_.behaviour.no_ids = true;
  session_.SetInput("v");
  EXPECT_EQ(session_.Run({"upload", "-", "--wait"}), 1);
  EXPECT_EQ(session_.TakeMessages(), "deltaray: the server's answer has no mesh id\n");
  EXPECT_EQ(session_.Run({"rebuild", "cube", "--wait"}), 1);
  EXPECT_EQ(session_.Run({"delete", "cube"}), 1);
  EXPECT_EQ(session_.TakeOutput(), "");
}

TEST_F(CommandsTest, IdsAndNamesOfTheServerCannotDriveTheTerminal) {
  const auto add = [&](const std::string& id) {
    v1::Mesh& mesh = server_.mesh_service.meshes[id];
    mesh.set_id(id);
    mesh.add_names("cube");
    mesh.add_warnings("\033[2J\x7F\xC2\x9B");
  };
  add("a\033[2J");
  for (const char* const command : {"list", "show", "stats", "watch"}) {
    for (const char* const format : {"table", "csv", "json"}) {
      if (command == std::string("list")) {
        EXPECT_EQ(session_.Run({command, "--format", format}), 0);
      } else {
        EXPECT_EQ(session_.Run({command, "cube", "--format", format}), 0);
      }
      const std::string output = session_.TakeOutput();
      EXPECT_THAT(output, Not(HasSubstr("\033"))) << command << format;
      EXPECT_THAT(output, Not(HasSubstr("\x7F"))) << command << format;
      EXPECT_THAT(output, Not(HasSubstr("\xC2\x9B"))) << command << format;
    }
  }
  EXPECT_EQ(session_.Run({"rebuild", "cube"}), 0);
  EXPECT_EQ(session_.TakeOutput(), "a?[2J\n");
  EXPECT_EQ(session_.Run({"name", "--remove", "cube"}), 0);
  EXPECT_EQ(session_.TakeOutput(), "a?[2J\n");
  add("a\033[2J");
  EXPECT_EQ(session_.Run({"delete", "cube"}), 0);
  EXPECT_EQ(session_.TakeOutput(), "a?[2J\n");
}

TEST_F(CommandsTest, IdsAndNamesThatAreNotUtf8AreRefused) {
  for (const char* const text : {"\xFF\xFE", "a\xC3", "\xC0\x80", "\xE0\x80\x80", "\xED\xA0\x80", "\xF0\x80\x80\x80",
                                 "\xF4\x90\x80\x80", "\xE2\x82", "\x80"}) {
    for (const char* const command : {"show", "watch", "stats", "rebuild", "delete", "health", "cast"}) {
      EXPECT_EQ(session_.Run({command, text}), 2) << command;
      EXPECT_THAT(session_.TakeMessages(), StartsWith("MESH: is not UTF-8\n"));
    }
    EXPECT_EQ(session_.Run({"render", text, "-o", "-"}), 2);
    EXPECT_EQ(session_.Run({"chart", text, "-o", "x.svg"}), 2);
    EXPECT_EQ(session_.Run({"name", text, "cube"}), 2);
    EXPECT_EQ(session_.Run({"name", "cube", text}), 2);
    EXPECT_EQ(session_.Run({"upload", "-", "--name", text}), 2);
  }
  for (const char* const text : {"größe", "\xEF\xBF\xBD", "\xED\x9F\xBF", "\xF0\x90\x80\x80", "\xF4\x8F\xBF\xBF"}) {
    EXPECT_EQ(session_.Run({"show", text}), 69) << text;
  }
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
  EXPECT_THAT(session_.TakeMessages(), HasSubstr("no tree was built yet"));
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

}  // namespace
}  // namespace deltaray
