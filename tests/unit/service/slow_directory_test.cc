// A directory that does not answer keeps nobody waiting but those who ask for what only it can tell.

#include <functional>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "gmock/gmock.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "gtest/gtest.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using grpc::health::v1::Health;
using grpc::health::v1::HealthCheckRequest;
using grpc::health::v1::HealthCheckResponse;

class SlowDirectoryTest : public RunningServer {
 protected:
  static void SetDeadline(grpc::ClientContext* context, int seconds = 30) {
    context->set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(seconds));
  }

  grpc::Status Check(const std::string& service) {
    grpc::ClientContext context;
    SetDeadline(&context);
    HealthCheckRequest request;
    request.set_service(service);
    HealthCheckResponse response;
    return Health::NewStub(channel_)->Check(&context, request, &response);
  }

  // What a watch tells first.
  HealthCheckResponse::ServingStatus Watch(const std::string& service) {
    grpc::ClientContext context;
    SetDeadline(&context);
    HealthCheckRequest request;
    request.set_service(service);
    HealthCheckResponse response;
    const auto reader = Health::NewStub(channel_)->Watch(&context, request);
    reader->Read(&response);
    context.TryCancel();
    reader->Finish();
    return response.status();
  }

  grpc::Status Get(const std::string& mesh) {
    grpc::ClientContext context;
    SetDeadline(&context);
    v1::GetMeshRequest request;
    request.set_mesh(mesh);
    v1::GetMeshResponse response;
    return meshes_->GetMesh(&context, request, &response);
  }

  grpc::Status WatchBuild(const std::string& mesh) {
    grpc::ClientContext context;
    SetDeadline(&context);
    v1::WatchBuildRequest request;
    request.set_mesh(mesh);
    const auto reader = meshes_->WatchBuild(&context, request);
    v1::WatchBuildResponse response;
    while (reader->Read(&response)) continue;
    return reader->Finish();
  }

  template <typename Request>
  static void AddRays(size_t rays, Request* request) {
    for (size_t i = 0; i < rays; ++i)
      request->mutable_rays()->mutable_rays()->append(Bytes<float>({0.25f, 0.5f, 9, 0, 0, -1}));
  }

  grpc::Status Cast(const std::string& mesh, size_t rays) {
    grpc::ClientContext context;
    SetDeadline(&context);
    v1::CastRaysRequest request;
    request.set_mesh(mesh);
    AddRays(rays, &request);
    v1::CastRaysResponse response;
    return rays_->CastRays(&context, request, &response);
  }

  grpc::Status Stream(const std::string& mesh) {
    grpc::ClientContext context;
    SetDeadline(&context);
    const auto stream = rays_->StreamRays(&context);
    v1::StreamRaysRequest request;
    request.mutable_start()->set_mesh(mesh);
    stream->Write(request);
    AddRays(10, &request);
    stream->Write(request);
    stream->WritesDone();
    v1::StreamRaysResponse response;
    while (stream->Read(&response)) continue;
    return stream->Finish();
  }
};

TEST_F(SlowDirectoryTest, KnownMeshesAreAnsweredWhileOthersAreLookedFor) {
  HeldLookUps look_ups;
  Start(look_ups.hooks());
  UploadSquares(1, 0, "squares");
  ASSERT_TRUE(Cast("squares", 1).ok());
  std::vector<std::future<grpc::Status>> unknown;
  for (int i = 0; i < 4; ++i) {
    for (const auto& call : std::vector<std::function<grpc::Status()>>{
             [&] { return Stream("nothing"); }, [&] { return WatchBuild("nothing"); },
             [&] { return Check("mesh/nothing"); }, [&] { return Cast("nothing", 1); },
             [&] { return Cast("nothing", 2000); }, [&] { return Get("nothing"); }}) {
      unknown.push_back(std::async(std::launch::async, call));
    }
  }
  auto watched = std::async(std::launch::async, [&] { return Watch("mesh/nothing"); });
  ASSERT_TRUE(look_ups.Await(4));
  // Those that are not looked for yet shall have come, too.
  std::this_thread::sleep_for(std::chrono::milliseconds(200));

  for (const char* service : {"", "mesh/squares"}) EXPECT_TRUE(Check(service).ok()) << service;
  EXPECT_EQ(Watch("mesh/squares"), HealthCheckResponse::SERVING);
  EXPECT_TRUE(Cast("squares", 1).ok());
  EXPECT_TRUE(Cast("squares", 2000).ok());
  EXPECT_TRUE(Stream("squares").ok());
  EXPECT_TRUE(WatchBuild("squares").ok());

  look_ups.LetGo();
  for (auto& call : unknown) {
    const grpc::Status status = call.get();
    EXPECT_EQ(status.error_code(), StatusCode::NOT_FOUND) << status.error_message();
  }
  EXPECT_EQ(watched.get(), HealthCheckResponse::SERVICE_UNKNOWN);
}

TEST_F(SlowDirectoryTest, WhatAnotherServerHasStoredIsFound) {
  options_.store.follow_interval = std::chrono::hours(1);
  Start();
  {
    absl::StatusOr<std::unique_ptr<Server>> other = Server::Start(options_);
    ASSERT_TRUE(other.ok()) << other.status();
    auto meshes = v1::MeshService::NewStub(
        grpc::CreateChannel(absl::StrCat("127.0.0.1:", (*other)->port()), grpc::InsecureChannelCredentials()));
    meshes_.swap(meshes);
    for (int i = 0; i < 8; ++i) UploadSquares(1, i, absl::StrCat("squares ", i));
    meshes_.swap(meshes);
  }
  // Each way to ask, of a mesh that was not asked for before.
  EXPECT_TRUE(Get("squares 0").ok());
  EXPECT_TRUE(Cast("squares 1", 1).ok());
  EXPECT_TRUE(Cast("squares 2", 2000).ok());
  EXPECT_TRUE(Stream("squares 3").ok());
  EXPECT_TRUE(WatchBuild("squares 4").ok());
  EXPECT_TRUE(Check("mesh/squares 5").ok());
  EXPECT_NE(Watch("mesh/squares 6"), HealthCheckResponse::SERVICE_UNKNOWN);
  EXPECT_TRUE(Stream("squares 0").ok());
  EXPECT_EQ(Get("squares 8").error_code(), StatusCode::NOT_FOUND);
}

TEST_F(SlowDirectoryTest, NothingIsDoneForACallThatHasEndedMeanwhile) {
  HeldLookUps look_ups;
  Start(look_ups.hooks());
  const std::string id = UploadSquares(1, 0, "squares");
  // They keep the threads that wait for the disk.
  std::vector<std::future<grpc::Status>> unknown;
  for (int i = 0; i < 4; ++i) unknown.push_back(std::async(std::launch::async, [&] { return Get("nothing"); }));
  ASSERT_TRUE(look_ups.Await(4));
  grpc::ClientContext context;
  SetDeadline(&context, 1);
  v1::DeleteMeshRequest request;
  request.set_mesh("squares");
  v1::DeleteMeshResponse response;
  EXPECT_EQ(meshes_->DeleteMesh(&context, request, &response).error_code(), StatusCode::DEADLINE_EXCEEDED);
  // The server, too, notices that the deadline has passed.
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  look_ups.LetGo();
  for (auto& call : unknown) EXPECT_EQ(call.get().error_code(), StatusCode::NOT_FOUND);
  // What waits for a thread is done before the server ends.
  server_.reset();
  const absl::StatusOr<std::unique_ptr<MeshStore>> store = MeshStore::Open(options_.store);
  ASSERT_TRUE(store.ok()) << store.status();
  EXPECT_TRUE((*store)->IsKnown(id));
}

}  // namespace
}  // namespace deltaray
