// A directory that does not answer keeps nobody waiting but those who ask for what only it can tell.

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <filesystem>
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

// A server that was stopped within a change: it holds the directory's lock.
class StoppedServer {
 public:
  explicit StoppedServer(const std::string& directory) : lock_(open((directory + "/lock").c_str(), O_RDWR)) {
    EXPECT_EQ(flock(lock_, LOCK_EX), 0);
  }
  ~StoppedServer() { GoOn(); }
  void GoOn() {
    if (lock_ >= 0) close(lock_);
    lock_ = -1;
  }

 private:
  int lock_;
};

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

  grpc::Status Name(const std::string& name, const std::string& mesh) {
    grpc::ClientContext context;
    SetDeadline(&context);
    v1::NameMeshRequest request;
    request.set_name(name);
    request.set_mesh(mesh);
    v1::NameMeshResponse response;
    return meshes_->NameMesh(&context, request, &response);
  }

  // Calls that change `mesh`, more than are made at once.
  std::vector<std::future<grpc::Status>> StartChanges(const std::string& mesh) {
    std::vector<std::future<grpc::Status>> changes;
    for (int i = 0; i < 8; ++i) {
      changes.push_back(
          std::async(std::launch::async, [this, mesh, i] { return Name(absl::StrCat("name ", i), mesh); }));
    }
    // They shall have come.
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    return changes;
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

  grpc::Status Cast(const std::string& mesh, size_t rays, int seconds = 30) {
    grpc::ClientContext context;
    SetDeadline(&context, seconds);
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
  Start();
  const std::string id = UploadSquares(1, 0, "squares");
  StoppedServer stopped(options_.store.data_directory);
  auto changes = StartChanges("squares");
  grpc::ClientContext context;
  SetDeadline(&context, 1);
  v1::DeleteMeshRequest request;
  request.set_mesh("squares");
  v1::DeleteMeshResponse response;
  EXPECT_EQ(meshes_->DeleteMesh(&context, request, &response).error_code(), StatusCode::DEADLINE_EXCEEDED);
  // The server, too, notices that the deadline has passed.
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  stopped.GoOn();
  for (auto& call : changes) EXPECT_TRUE(call.get().ok());
  // What waits for a thread is done before the server ends.
  server_.reset();
  const absl::StatusOr<std::unique_ptr<MeshStore>> store = MeshStore::Open(options_.store);
  ASSERT_TRUE(store.ok()) << store.status();
  EXPECT_TRUE((*store)->IsKnown(id));
}

TEST_F(SlowDirectoryTest, ChangesThatWaitForAnotherServerHoldUpNoReads) {
  Start();
  UploadSquares(1, 0, "squares");
  StoppedServer stopped(options_.store.data_directory);
  auto changes = StartChanges("squares");
  EXPECT_TRUE(Get("squares").ok());
  EXPECT_EQ(Get("nothing").error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(Cast("nothing", 1).error_code(), StatusCode::NOT_FOUND);
  for (auto& call : changes) EXPECT_EQ(call.wait_for(std::chrono::seconds(0)), std::future_status::timeout);
  stopped.GoOn();
  for (auto& call : changes) EXPECT_TRUE(call.get().ok());
}

TEST_F(SlowDirectoryTest, CallsThatWaitForItLeaveTheirMemoryWhenTheyEnd) {
  options_.batch.max_message_bytes = 4 << 20;
  options_.batch_bytes = 16 << 20;
  HeldLookUps look_ups;
  Start(look_ups.hooks());
  UploadSquares(1, 0, "squares");
  // They keep the threads that wait for the disk.
  std::vector<std::future<grpc::Status>> unknown;
  for (int i = 0; i < 4; ++i) unknown.push_back(std::async(std::launch::async, [&] { return Get("nothing"); }));
  ASSERT_TRUE(look_ups.Await(4));
  std::vector<std::future<grpc::Status>> batches;
  for (int i = 0; i < 8; ++i)
    batches.push_back(std::async(std::launch::async, [&] { return Cast("nothing", 100'000, 3); }));
  for (auto& call : batches) EXPECT_FALSE(call.get().ok());
  const grpc::Status status = Cast("squares", 100'000, 10);
  EXPECT_TRUE(status.ok()) << status.error_message();
  look_ups.LetGo();
  for (auto& call : unknown) EXPECT_EQ(call.get().error_code(), StatusCode::NOT_FOUND);
}

TEST_F(SlowDirectoryTest, ARequestThatIsTooLargeIsRefusedBeforeItWaits) {
  HeldLookUps look_ups;
  Start(look_ups.hooks());
  std::vector<std::future<grpc::Status>> unknown;
  for (int i = 0; i < 4; ++i) unknown.push_back(std::async(std::launch::async, [&] { return Get("nothing"); }));
  ASSERT_TRUE(look_ups.Await(4));
  auto large = std::async(std::launch::async, [&] {
    v1::GetMeshRequest request;
    request.set_mesh(std::string(70'000, 'm'));
    grpc::ByteBuffer response;
    return CallRaw("/deltaray.v1.MeshService/GetMesh", request.SerializeAsString(), &response);
  });
  EXPECT_EQ(large.wait_for(std::chrono::seconds(10)), std::future_status::ready);
  look_ups.LetGo();
  EXPECT_EQ(large.get().error_code(), StatusCode::RESOURCE_EXHAUSTED);
  for (auto& call : unknown) EXPECT_EQ(call.get().error_code(), StatusCode::NOT_FOUND);
}

TEST_F(SlowDirectoryTest, AWatchWhoseMeshIsStillLookedForIsToldTheDrain) {
  HeldLookUps look_ups;
  Start(look_ups.hooks());
  grpc::ClientContext context;
  SetDeadline(&context);
  HealthCheckRequest request;
  request.set_service("mesh/squares");
  const auto reader = Health::NewStub(channel_)->Watch(&context, request);
  ASSERT_TRUE(look_ups.Await(1));
  auto drained = std::async(std::launch::async, [this] { return server_->Drain(); });
  HealthCheckResponse response;
  EXPECT_TRUE(reader->Read(&response));
  EXPECT_EQ(response.status(), HealthCheckResponse::NOT_SERVING);
  EXPECT_FALSE(reader->Read(&response));
  EXPECT_EQ(reader->Finish().error_code(), StatusCode::UNAVAILABLE);
  EXPECT_TRUE(drained.get());
}

TEST_F(SlowDirectoryTest, AMeshWhoseFileIsDamagedIsLookedForOnceASecond) {
  Start();
  const std::string id = UploadSquares(1, 0);
  server_.reset();
  std::filesystem::resize_file(absl::StrCat(options_.store.data_directory, "/meshes/", id, ".mesh"), 50);
  const auto look_ups = std::make_shared<std::atomic<int>>(0);
  HookedStore::Hooks hooks;
  hooks.on_look_up = [look_ups] { ++*look_ups; };
  Start(hooks);
  grpc::ClientContext context;
  SetDeadline(&context);
  HealthCheckRequest request;
  request.set_service("mesh/" + id);
  const auto begin = std::chrono::steady_clock::now();
  const auto reader = Health::NewStub(channel_)->Watch(&context, request);
  HealthCheckResponse response;
  ASSERT_TRUE(reader->Read(&response));
  EXPECT_EQ(response.status(), HealthCheckResponse::NOT_SERVING);
  EXPECT_TRUE(Eventually([&] { return *look_ups >= 3; }));
  EXPECT_GE(std::chrono::steady_clock::now() - begin, std::chrono::milliseconds(1900));
  context.TryCancel();
  reader->Finish();
}

}  // namespace
}  // namespace deltaray
