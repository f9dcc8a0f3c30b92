#include "client/message_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "client/mesh_text.h"
#include "deltaray/v1/mesh_service.pb.h"

namespace deltaray {
namespace {

TEST(MessageTextTest, JsonIsOneLineWithTheContractsNames) {
  v1::BuildProgress progress;
  progress.set_state(v1::MESH_STATE_READY);
  progress.set_delta_leaves(7);
  progress.set_elapsed_seconds(0.5);
  EXPECT_EQ(JsonLine(progress),
            R"({"state":"MESH_STATE_READY","build_number":"0","phase":"BUILD_PHASE_UNSPECIFIED",)"
            R"("references_placed":"0","triangles":"0","delta_leaves":"7","delta_leaves_built":"0",)"
            R"("elapsed_seconds":0.5,"failure":""})"
            "\n");
}

TEST(MessageTextTest, BoundsFarFromZeroCanBeToldApart) {
  v1::Mesh mesh;
  mesh.mutable_bounds()->mutable_min()->set_x(4500001.25);
  mesh.mutable_bounds()->mutable_max()->set_x(4500002.5);
  EXPECT_THAT(MeshText(mesh), testing::HasSubstr(" 4500001.25 0 0  to  4500002.5 0 0\n"));
}

TEST(MessageTextTest, CsvHasShortEnumsAndQuotes) {
  v1::BuildProgress progress;
  progress.set_state(v1::MESH_STATE_FAILED);
  progress.set_elapsed_seconds(0.1);
  progress.set_failure("it said \"no\", twice");
  EXPECT_EQ(CsvHeader(progress),
            "state,build_number,phase,references_placed,triangles,delta_leaves,delta_leaves_built,elapsed_seconds,"
            "failure\n");
  EXPECT_EQ(CsvRow(progress), "failed,0,unspecified,0,0,0,0,0.1,\"it said \"\"no\"\", twice\"\n");
}

TEST(MessageTextTest, CsvColumnsOfAMeshDoNotDependOnWhatIsSet) {
  v1::Mesh empty;
  v1::Mesh full;
  full.mutable_bounds()->mutable_min()->set_x(-1.5);
  full.mutable_build_options()->set_alpha(0);
  full.mutable_create_time()->set_seconds(0);
  for (const std::string name : {"a", "b"}) full.add_names(name);
  EXPECT_EQ(CsvHeader(empty), CsvHeader(full));
  const std::string header = CsvHeader(full);
  const std::string row = CsvRow(full);
  EXPECT_EQ(std::count(header.begin(), header.end(), ','), std::count(row.begin(), row.end(), ','));
  // names; vertex, triangle, face and degenerate counts; bounds.
  EXPECT_EQ(row.substr(0, 18), ",a;b,0,0,0,0,-1.5,");
  EXPECT_NE(row.find(",1970-01-01T00:00:00Z,"), std::string::npos);
  // Unset: bounds are empty, not zero, and so is alpha, which is set to 0 in the other.
  EXPECT_EQ(CsvRow(empty).substr(0, 17), ",,0,0,0,0,,,,,,,,");
}

TEST(MessageTextTest, CsvNumbersRepeatedMessagesAndJoinsScalars) {
  v1::GetBuildStatsResponse response;
  v1::PhaseTime& phase = *response.mutable_stats()->add_phases();
  phase.set_phase(v1::BUILD_PHASE_TOP);
  phase.set_wall_seconds(0.25);
  response.mutable_stats()->add_delta_leaf_size_histogram(1);
  response.mutable_stats()->add_delta_leaf_size_histogram(22);
  EXPECT_NE(CsvHeader(response).find(",stats.phases.0.phase,stats.phases.0.wall_seconds,"), std::string::npos);
  EXPECT_NE(CsvRow(response).find(",top,0.25,"), std::string::npos);
  EXPECT_NE(CsvRow(response).find(",1;22,"), std::string::npos);
}

}  // namespace
}  // namespace deltaray
