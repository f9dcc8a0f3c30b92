#include "server/service/health.h"

#include <atomic>
#include <future>
#include <memory>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using grpc::health::v1::HealthCheckRequest;
using grpc::health::v1::HealthCheckResponse;

class HealthTest : public RunningServer {
 protected:
  std::unique_ptr<grpc::health::v1::Health::Stub> NewStub() { return grpc::health::v1::Health::NewStub(channel_); }

  static HealthCheckRequest Request(const std::string& service) {
    HealthCheckRequest request;
    request.set_service(service);
    return request;
  }

  grpc::Status Check(const std::string& service, HealthCheckResponse* response) {
    grpc::ClientContext context;
    return NewStub()->Check(&context, Request(service), response);
  }

  // SERVING, NOT_SERVING, or the text of the error.
  std::string Told(const std::string& service) {
    HealthCheckResponse response;
    const grpc::Status status = Check(service, &response);
    return status.ok() ? HealthCheckResponse::ServingStatus_Name(response.status()) : status.error_message();
  }
};

// A watch of one service.
class Watch {
 public:
  Watch(std::unique_ptr<grpc::health::v1::Health::Stub> stub, const HealthCheckRequest& request)
      : stub_(std::move(stub)), reader_(stub_->Watch(&context_, request)) {}

  // The next health, or the code that the watch ended with.
  std::string Next() {
    HealthCheckResponse response;
    if (reader_->Read(&response)) return HealthCheckResponse::ServingStatus_Name(response.status());
    return absl::StrCat("code ", reader_->Finish().error_code());
  }

  grpc::ClientContext& context() { return context_; }

 private:
  grpc::ClientContext context_;
  const std::unique_ptr<grpc::health::v1::Health::Stub> stub_;
  const std::unique_ptr<grpc::ClientReader<HealthCheckResponse>> reader_;
};

TEST_F(HealthTest, AMeshServesOnceItCanAnswerRays) {
  // Builds outlive the test's body.
  const auto enough = std::make_shared<std::atomic<bool>>(false);
  options_.store.on_delta_leaf = [enough] {
    while (!*enough) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  };
  Start();
  Watch by_name(NewStub(), Request("mesh/squares"));
  EXPECT_EQ(by_name.Next(), "SERVICE_UNKNOWN");
  const std::string id = UploadSquares(100, 0, "squares");
  EXPECT_TRUE(Eventually([&] { return Told("mesh/" + id) == "SERVING"; }));
  std::string told = by_name.Next();
  if (told == "NOT_SERVING") told = by_name.Next();
  EXPECT_EQ(told, "SERVING");
  *enough = true;

  grpc::ClientContext context;
  v1::DeleteMeshRequest request;
  request.set_mesh("squares");
  v1::DeleteMeshResponse response;
  ASSERT_TRUE(meshes_->DeleteMesh(&context, request, &response).ok());
  EXPECT_EQ(by_name.Next(), "SERVICE_UNKNOWN");
  HealthCheckResponse health;
  EXPECT_EQ(Check("mesh/squares", &health).error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(Check("mesh/", &health).error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(Told("mesh/squares"), "no such service or mesh: \"mesh/squares\"");
  EXPECT_EQ(Told("\x1b" + std::string(100, 'x')), "no such service or mesh: \"\\x1b" + std::string(39, 'x') + "...\"");
}

TEST_F(HealthTest, AMeshThatWaitsForItsTurnOrFailsDoesNotServe) {
  // Builds outlive the test's body.
  const auto enough = std::make_shared<std::atomic<bool>>(false);
  options_.store.on_delta_leaf = [enough] {
    while (!*enough) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  };
  Start();
  UploadSquares(100, 0, "first");
  const std::string id = UploadSquares(100, 1000, "second");
  EXPECT_EQ(Told("mesh/second"), "NOT_SERVING");
  *enough = true;
  EXPECT_TRUE(Eventually([&] { return Told("mesh/second") == "SERVING"; }));

  // The file is damaged while there is no tree.
  server_.reset();
  std::filesystem::resize_file(options_.store.data_directory + "/meshes/" + id + ".mesh", 700);
  Start();
  EXPECT_TRUE(Eventually([&] { return Told("mesh/first") == "SERVING"; })) << "its build is started by the check";
  // A call that waits for the tree ends when the build has failed.
  grpc::ClientContext context;
  v1::CastRaysRequest request;
  request.set_mesh(id);
  request.mutable_query()->set_wait(v1::BUILD_WAIT_FINAL);
  v1::CastRaysResponse response;
  EXPECT_FALSE(rays_->CastRays(&context, request, &response).ok());
  EXPECT_EQ(Told("mesh/" + id), "NOT_SERVING");
}

TEST_F(HealthTest, AMeshServesWhileItIsRebuilt) {
  // Builds outlive the test's body.
  const auto hold = std::make_shared<std::atomic<bool>>(false);
  options_.store.on_delta_leaf = [hold] {
    while (*hold) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  };
  Start();
  UploadSquares(100, 0, "squares");
  ASSERT_TRUE(Eventually([&] { return Told("mesh/squares") == "SERVING"; }));
  *hold = true;
  grpc::ClientContext context;
  v1::RebuildMeshRequest request;
  request.set_mesh("squares");
  v1::RebuildMeshResponse response;
  ASSERT_TRUE(meshes_->RebuildMesh(&context, request, &response).ok());
  for (int i = 0; i < 20; ++i) EXPECT_EQ(Told("mesh/squares"), "SERVING");
  *hold = false;
}

TEST_F(HealthTest, DrainIsToldToWatches) {
  Start();
  UploadSquares(1, 0, "squares");
  ASSERT_TRUE(Eventually([&] { return Told("mesh/squares") == "SERVING"; }));
  Watch server(NewStub(), Request("")), mesh(NewStub(), Request("mesh/squares")), other(NewStub(), Request("other"));
  EXPECT_EQ(server.Next(), "SERVING");
  EXPECT_EQ(mesh.Next(), "SERVING");
  EXPECT_EQ(other.Next(), "SERVICE_UNKNOWN");
  auto drained = std::async(std::launch::async, [this] { return server_->Drain(); });
  EXPECT_EQ(server.Next(), "NOT_SERVING");
  EXPECT_EQ(mesh.Next(), "NOT_SERVING");
  EXPECT_EQ(server.Next(), absl::StrCat("code ", StatusCode::UNAVAILABLE));
  EXPECT_EQ(mesh.Next(), absl::StrCat("code ", StatusCode::UNAVAILABLE));
  EXPECT_EQ(other.Next(), absl::StrCat("code ", StatusCode::UNAVAILABLE));
  EXPECT_TRUE(drained.get());
}

TEST_F(HealthTest, WatchesEndWithTheirClient) {
  Start();
  for (int i = 0; i < 20; ++i) {
    Watch watch(NewStub(), Request(i % 2 == 0 ? "" : "mesh/none"));
    EXPECT_EQ(watch.Next(), i % 2 == 0 ? "SERVING" : "SERVICE_UNKNOWN");
    watch.context().TryCancel();
    EXPECT_EQ(watch.Next(), absl::StrCat("code ", StatusCode::CANCELLED));
  }
}

TEST_F(HealthTest, AMalformedRequestIsRefused) {
  Start();
  grpc::ByteBuffer response;
  EXPECT_EQ(CallRaw("/grpc.health.v1.Health/Check", "\x0a\x7f", &response).error_code(), StatusCode::INVALID_ARGUMENT);
  // What a watch is asked for stays in memory.
  Watch watch(NewStub(), Request(std::string(70'000, 's')));
  EXPECT_EQ(watch.Next(), absl::StrCat("code ", StatusCode::RESOURCE_EXHAUSTED));
}

}  // namespace
}  // namespace deltaray
