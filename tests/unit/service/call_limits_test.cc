#include "server/service/call_limits.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

class CallLimitsTest : public RunningServer {
 protected:
  using Stream = grpc::ClientReaderWriter<v1::StreamRaysRequest, v1::StreamRaysResponse>;

  // A stream that has answered a batch, so that it is known to the server.
  std::unique_ptr<Stream> OpenStream(grpc::ClientContext* context) {
    auto stream = rays_->StreamRays(context);
    v1::StreamRaysRequest request;
    request.mutable_start()->set_mesh("squares");
    stream->Write(request);
    request.mutable_rays()->set_rays(Bytes<float>({0.25f, 0.5f, 9, 0, 0, -1}));
    stream->Write(request);
    v1::StreamRaysResponse response;
    return stream->Read(&response) ? std::move(stream) : nullptr;
  }

  grpc::Status List() {
    grpc::ClientContext context;
    v1::ListMeshesResponse list;
    return meshes_->ListMeshes(&context, {}, &list);
  }
};

TEST_F(CallLimitsTest, RefusesStreamsOverTheLimitUntilOneHasEnded) {
  options_.calls.streams = 2;
  Start();
  UploadSquares(1, 0, "squares");
  grpc::ClientContext first_context, second_context;
  auto first = OpenStream(&first_context), second = OpenStream(&second_context);
  ASSERT_TRUE(first != nullptr && second != nullptr);
  for (int i = 0; i < 3; ++i) {
    grpc::ClientContext context;
    const grpc::Status refused = rays_->StreamRays(&context)->Finish();
    EXPECT_EQ(refused.error_code(), StatusCode::RESOURCE_EXHAUSTED);
    EXPECT_THAT(refused.error_message(), HasSubstr("limit of 2 streams at once (--max-streams)"));
  }
  EXPECT_TRUE(List().ok());
  first->WritesDone();
  EXPECT_TRUE(first->Finish().ok());
  EXPECT_TRUE(Eventually([&] {
    grpc::ClientContext context;
    return OpenStream(&context) != nullptr;
  }));
}

TEST_F(CallLimitsTest, RefusesUploadsOverTheLimitUntilOneIsCancelled) {
  options_.calls.uploads = 1;
  Start();
  v1::UploadMeshResponse response, held_response;
  std::unique_ptr<grpc::ClientContext> held_context;
  std::unique_ptr<grpc::ClientWriter<v1::UploadMeshRequest>> held;
  grpc::Status refused;
  // The one that is held may come second, and be refused itself.
  ASSERT_TRUE(Eventually([&] {
    if (held != nullptr) {
      held_context->TryCancel();
      held->Finish();
    }
    held.reset();
    held_context = std::make_unique<grpc::ClientContext>();
    held = meshes_->UploadMesh(held_context.get(), &held_response);
    held->Write({});
    refused = Upload(SquaresObj(1), {}, &response);
    return !refused.ok();
  }));
  EXPECT_EQ(refused.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(refused.error_message(), HasSubstr("limit of 1 uploads at once (--max-uploads)"));
  held_context->TryCancel();
  held->Finish();
  EXPECT_TRUE(Eventually([&] { return Upload(SquaresObj(1), {}, &response).ok(); }));
}

TEST_F(CallLimitsTest, RefusesCallsOfAnyKindOverTheLimitButNotHealthChecks) {
  options_.calls.calls = 1;
  Start();
  UploadSquares(1, 0, "squares");
  std::unique_ptr<grpc::ClientContext> context;
  std::unique_ptr<Stream> stream;
  // The upload takes a while to end on the server's side.
  ASSERT_TRUE(Eventually([&] {
    stream.reset();
    context = std::make_unique<grpc::ClientContext>();
    stream = OpenStream(context.get());
    return stream != nullptr;
  }));
  const grpc::Status refused = List();
  EXPECT_EQ(refused.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(refused.error_message(), HasSubstr("limit of 1 calls at once (--max-calls)"));
  grpc::ByteBuffer response;
  EXPECT_TRUE(CallRaw("/grpc.health.v1.Health/Check", "", &response).ok());
}

TEST_F(CallLimitsTest, CallsThatFollowEachOtherTakeOnePlace) {
  options_.calls.calls = options_.calls.streams = options_.calls.uploads = 1;
  Start();
  UploadSquares(1, 0, "squares");
  for (int i = 0; i < 200; ++i) {
    ASSERT_TRUE(List().ok()) << i;
    v1::UploadMeshResponse response;
    if (i % 10 == 0) {
      ASSERT_TRUE(Upload(SquaresObj(1), {}, &response).ok()) << i;
    }
    grpc::ClientContext context;
    const auto stream = OpenStream(&context);
    ASSERT_TRUE(stream != nullptr) << i;
    stream->WritesDone();
    ASSERT_TRUE(stream->Finish().ok()) << i;
    grpc::ClientContext watch_context;
    v1::WatchBuildRequest watch;
    watch.set_mesh("squares");
    const auto progress = meshes_->WatchBuild(&watch_context, watch);
    v1::WatchBuildResponse step;
    while (progress->Read(&step)) {
    }
    ASSERT_TRUE(progress->Finish().ok()) << i;
  }
}

TEST(CallLimitsPlacesTest, AnswersThatAreNotTakenHavePlacesToo) {
  CallLimits limits({.calls = 100, .streams = 100, .uploads = 2});
  grpc::CallbackServerContext contexts[19];
  const auto rpc = [&](int i) { return RpcInfo{"MeshService/UploadMesh", &contexts[i]}; };
  for (int i = 0; i < 18; ++i) {
    RpcInfo upload = rpc(i);
    ASSERT_TRUE(limits.OnBegin(upload).ok()) << i;
    limits.OnAnswer(upload);
  }
  RpcInfo upload = rpc(18);
  const absl::Status refused = limits.OnBegin(upload);
  EXPECT_EQ(refused.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(refused.message()), HasSubstr("the answers of 18 uploads were not taken yet"));
  limits.OnAnswer(upload);
  limits.OnEnd(upload, refused);
  limits.OnEnd(rpc(0), absl::OkStatus());
  EXPECT_TRUE(limits.OnBegin(upload).ok());
  limits.OnEnd(upload, absl::OkStatus());
  EXPECT_TRUE(limits.OnBegin(upload).ok());
}

// Two more than a connection may have: gRPC's clients wait until there is room.
TEST_F(CallLimitsTest, CallsOverTheLimitOfAConnectionWait) {
  options_.max_connection_calls = 2;
  Start();
  UploadSquares(1, 0, "squares");
  grpc::ClientContext first_context, second_context;
  auto first = OpenStream(&first_context), second = OpenStream(&second_context);
  ASSERT_TRUE(first != nullptr && second != nullptr);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::milliseconds(300));
  v1::ListMeshesResponse list;
  EXPECT_EQ(meshes_->ListMeshes(&context, {}, &list).error_code(), StatusCode::DEADLINE_EXCEEDED);
  first->WritesDone();
  EXPECT_TRUE(first->Finish().ok());
  EXPECT_TRUE(List().ok());
}

TEST_F(CallLimitsTest, RefusesMetadataOverTheLimit) {
  options_.max_metadata_bytes = 2000;
  Start();
  grpc::ClientContext context;
  context.AddMetadata("long", std::string(3000, 'x'));
  v1::ListMeshesResponse list;
  EXPECT_EQ(meshes_->ListMeshes(&context, {}, &list).error_code(), StatusCode::RESOURCE_EXHAUSTED);
  // gRPC may close the connection of a client that sends before it knows the limit.
  EXPECT_TRUE(Eventually([&] { return List().ok(); }));
}

TEST_F(CallLimitsTest, EndsStreamsAndUploadsWhoseClientDoesNothing) {
  options_.idle_timeout = std::chrono::milliseconds(500);
  Start();
  UploadSquares(1, 0, "squares");
  grpc::ClientContext stream_context, upload_context;
  auto stream = OpenStream(&stream_context);
  ASSERT_NE(stream, nullptr);
  v1::UploadMeshResponse response;
  auto upload = meshes_->UploadMesh(&upload_context, &response);
  v1::UploadMeshRequest header;
  header.mutable_header();
  upload->Write(header);
  for (const grpc::Status& status : {stream->Finish(), upload->Finish()}) {
    EXPECT_EQ(status.error_code(), StatusCode::DEADLINE_EXCEEDED);
    EXPECT_THAT(status.error_message(), HasSubstr("the client has sent nothing for 500ms (--idle-timeout)"));
  }
}

TEST_F(CallLimitsTest, EndsStreamsWhoseClientTakesNoReplies) {
  options_.idle_timeout = std::chrono::seconds(2);
  Start();
  UploadSquares(1, 0, "squares");
  std::string rays;
  for (int i = 0; i < 100'000; ++i) rays += Bytes<float>({0.25f, 0.5f, 9, 0, 0, -1});
  grpc::ClientContext context;
  auto stream = rays_->StreamRays(&context);
  v1::StreamRaysRequest request;
  request.mutable_start()->set_mesh("squares");
  stream->Write(request);
  request.mutable_rays()->set_rays(rays);
  // Writes fail once the server has ended the call, which no read tells us of.
  int written = 0;
  while (written < 1000 && stream->Write(request)) ++written;
  EXPECT_LT(written, 100);
  v1::StreamRaysResponse response;
  while (stream->Read(&response)) {
  }
  const grpc::Status status = stream->Finish();
  EXPECT_EQ(status.error_code(), StatusCode::DEADLINE_EXCEEDED) << status.error_message();
  EXPECT_THAT(status.error_message(), HasSubstr("the client has not taken a reply for 2s (--idle-timeout)"));
}

}  // namespace
}  // namespace deltaray
