#include "server/service/call_log.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/captured_log.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using testing::ContainsRegex;
using testing::HasSubstr;
using testing::MatchesRegex;

class CallLogTest : public RunningServer {
 protected:
  // What GetMesh of an unknown mesh gives back as request id.
  std::string RequestId(const std::vector<std::string>& sent) {
    grpc::ClientContext context;
    for (const std::string& id : sent) context.AddMetadata("x-request-id", id);
    v1::GetMeshRequest request;
    request.set_mesh("nothing");
    v1::GetMeshResponse response;
    EXPECT_EQ(meshes_->GetMesh(&context, request, &response).error_code(), grpc::StatusCode::NOT_FOUND);
    const auto& trailers = context.GetServerTrailingMetadata();
    EXPECT_EQ(trailers.count("x-request-id"), 1u);
    const auto id = trailers.find("x-request-id");
    return id == trailers.end() ? "" : std::string(id->second.data(), id->second.size());
  }
};

TEST_F(CallLogTest, ARequestIdIsTakenWhereValidAndElseMade) {
  Start();
  EXPECT_EQ(RequestId({"my-request.7"}), "my-request.7");
  EXPECT_EQ(RequestId({std::string(64, 'x')}), std::string(64, 'x'));
  const std::string made = RequestId({});
  EXPECT_THAT(made, MatchesRegex("[0-9a-f]{16}-[0-9]+"));
  EXPECT_NE(RequestId({}), made);
  for (const std::string& bad : {std::string(65, 'x'), std::string("two words"), std::string()}) {
    EXPECT_THAT(RequestId({bad}), MatchesRegex("[0-9a-f]{16}-[0-9]+")) << bad;
  }
}

TEST_F(CallLogTest, LinesOfACallHaveItsRequestId) {
  CapturedLog log(LogFormat::kText);
  Start();
  const std::string unknown = RequestId({});
  grpc::ClientContext context;
  context.AddMetadata("x-request-id", "upload-1");
  v1::UploadMeshResponse response;
  auto writer = meshes_->UploadMesh(&context, &response);
  v1::UploadMeshRequest message;
  message.mutable_header()->set_name("squares");
  writer->Write(message);
  message.set_chunk(SquaresObj(2));
  writer->Write(message);
  writer->WritesDone();
  ASSERT_TRUE(writer->Finish().ok());
  server_.reset();
  const std::string text = log.text();
  EXPECT_THAT(text, HasSubstr("named squares request_id=\"upload-1\""));
  EXPECT_THAT(text, ContainsRegex("\\[debug\\] call method=\"MeshService/UploadMesh\" peer=\"ipv4:127.0.0.1:"
                                  "[0-9]+\" code=\"OK\" ms=[0-9.e+]+ batches=0 rays=0 request_id=\"upload-1\""));
  EXPECT_THAT(text, ContainsRegex(absl::StrCat("\\[info\\] call method=\"MeshService/GetMesh\".*NOT_FOUND.*error="
                                               "\"no mesh is named nothing\" request_id=\"",
                                               unknown, "\"")));
}

}  // namespace
}  // namespace deltaray
