#include "server/service/server.h"

#include <atomic>
#include <cfenv>
#include <filesystem>
#include <future>
#include <iterator>
#include <thread>

#include "gmock/gmock.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "gtest/gtest.h"
#include "tests/unit/service/captured_log.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

class ServerTest : public RunningServer {
 protected:
  // SERVING, NOT_SERVING, or the code of an error.
  std::string Health(const std::string& service) {
    grpc::ClientContext context;
    grpc::health::v1::HealthCheckRequest request;
    request.set_service(service);
    grpc::health::v1::HealthCheckResponse response;
    const grpc::Status status = grpc::health::v1::Health::NewStub(channel_)->Check(&context, request, &response);
    if (!status.ok()) return absl::StrCat("error ", status.error_code());
    return grpc::health::v1::HealthCheckResponse::ServingStatus_Name(response.status());
  }

  using ReflectionStream = std::unique_ptr<grpc::ClientReaderWriter<grpc::ByteBuffer, grpc::ByteBuffer>>;
  // A call that asks for the services, and stays open.
  ReflectionStream Reflection(grpc::ClientContext* context) {
    ReflectionStream stream(grpc::internal::ClientReaderWriterFactory<grpc::ByteBuffer, grpc::ByteBuffer>::Create(
        channel_.get(),
        grpc::internal::RpcMethod("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
                                  grpc::internal::RpcMethod::BIDI_STREAMING),
        context));
    // ServerReflectionRequest with list_services = "*".
    grpc::Slice slice(std::string("\x3a\x01*"));
    stream->Write(grpc::ByteBuffer(&slice, 1));
    return stream;
  }

  static std::string SlowRays(size_t count) {
    std::string rays;
    for (size_t i = 0; i < count; ++i) rays += Bytes<float>({0.25f, 0.5f, 9, 0, 0, -1});
    return rays;
  }

  // A stream on "squares" with one batch of that many rays.
  auto StreamOf(size_t rays, grpc::ClientContext* context, const v1::RayQuery& query = {}) {
    auto stream = rays_->StreamRays(context);
    v1::StreamRaysRequest request;
    request.mutable_start()->set_mesh("squares");
    *request.mutable_start()->mutable_query() = query;
    stream->Write(request);
    request.mutable_rays()->set_rays(SlowRays(rays));
    stream->Write(request);
    return stream;
  }
};

TEST_F(ServerTest, HealthKnowsTheServerAndBothServices) {
  Start();
  for (const char* service : {"", "deltaray.v1.MeshService", "deltaray.v1.RayService"}) {
    EXPECT_EQ(Health(service), "SERVING") << service;
  }
  EXPECT_EQ(Health("deltaray.v1.NoService"), absl::StrCat("error ", StatusCode::NOT_FOUND));
}

TEST_F(ServerTest, HealthIsAnsweredWhileALargeBatchIsTracedOnTheSameConnection) {
  HeldQueries queries;
  Start(queries.hooks());
  UploadSquares(1, 0, "squares");
  v1::CastRaysRequest request;
  request.set_mesh("squares");
  request.mutable_rays()->set_rays(SlowRays(2000));
  v1::CastRaysResponse response;
  auto cast = std::async(std::launch::async, [&] {
    grpc::ClientContext context;
    return rays_->CastRays(&context, request, &response).ok();
  });
  ASSERT_TRUE(queries.Await());
  const auto start = std::chrono::steady_clock::now();
  EXPECT_EQ(Health(""), "SERVING");
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(1));
  queries.LetGo();
  EXPECT_TRUE(cast.get());
}

TEST_F(ServerTest, DrainFinishesTheBatchUnderWayAndEndsIdleStreams) {
  HeldQueries queries;
  Start(queries.hooks());
  UploadSquares(1, 0, "squares");

  grpc::ClientContext idle_context, busy_context, upload_context;
  auto idle = rays_->StreamRays(&idle_context);
  v1::StreamRaysRequest start;
  start.mutable_start()->set_mesh("squares");
  idle->Write(start);
  v1::UploadMeshResponse uploaded;
  auto upload = meshes_->UploadMesh(&upload_context, &uploaded);
  v1::UploadMeshRequest header;
  header.mutable_header();
  upload->Write(header);
  auto busy = StreamOf(3000, &busy_context);
  ASSERT_TRUE(queries.Await());

  auto drained = std::async(std::launch::async, [this] { return server_->Drain(); });
  v1::StreamRaysResponse response;
  EXPECT_FALSE(idle->Read(&response));
  EXPECT_EQ(idle->Finish().error_code(), StatusCode::UNAVAILABLE);
  EXPECT_EQ(upload->Finish().error_code(), StatusCode::UNAVAILABLE);
  EXPECT_EQ(Health("deltaray.v1.RayService"), "NOT_SERVING");
  EXPECT_EQ(Health(""), "NOT_SERVING");
  grpc::ClientContext context;
  v1::ListMeshesResponse list;
  const grpc::Status refused = meshes_->ListMeshes(&context, {}, &list);
  EXPECT_EQ(refused.error_code(), StatusCode::UNAVAILABLE);
  EXPECT_THAT(refused.error_message(), HasSubstr("draining"));

  queries.LetGo();
  EXPECT_TRUE(busy->Read(&response));
  EXPECT_EQ(response.hits().ray_count(), 3000u);
  EXPECT_FALSE(busy->Read(&response));
  EXPECT_EQ(busy->Finish().error_code(), StatusCode::UNAVAILABLE);
  EXPECT_TRUE(drained.get());
}

TEST_F(ServerTest, AStreamThatHasSentAllEndsWellInADrain) {
  HeldQueries queries;
  Start(queries.hooks());
  UploadSquares(1, 0, "squares");
  grpc::ClientContext context;
  auto stream = StreamOf(3000, &context);
  stream->WritesDone();
  ASSERT_TRUE(queries.Await());
  std::this_thread::sleep_for(std::chrono::milliseconds(200));  // until the server has read the end, too

  auto drained = std::async(std::launch::async, [this] { return server_->Drain(); });
  ASSERT_TRUE(Eventually([&] { return Health("") == "NOT_SERVING"; }));
  queries.LetGo();
  v1::StreamRaysResponse response;
  EXPECT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.hits().ray_count(), 3000u);
  EXPECT_FALSE(stream->Read(&response));
  const grpc::Status status = stream->Finish();
  EXPECT_TRUE(status.ok()) << status.error_message();
  EXPECT_TRUE(drained.get());
}

TEST_F(ServerTest, DrainCutsOffWhatTakesTooLong) {
  const CapturedLog log(LogFormat::kText);
  HeldQueries queries;
  options_.drain_timeout = std::chrono::milliseconds(300);
  Start(queries.hooks());
  UploadSquares(1, 0, "squares");
  grpc::ClientContext context;
  auto stream = StreamOf(3000, &context);
  ASSERT_TRUE(queries.Await());
  const auto start = std::chrono::steady_clock::now();
  EXPECT_FALSE(server_->Drain());
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(3));
  EXPECT_FALSE(stream->Finish().ok());
  queries.LetGo();
  server_.reset();
  EXPECT_THAT(log.text(), HasSubstr("cut off at the end of the server's drain"));
}

TEST_F(ServerTest, DrainDoesNotWaitForABuild) {
  std::atomic<bool> enough{false};
  options_.store.on_delta_leaf = [&] {
    while (!enough) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  };
  Start();
  UploadSquares(100, 0, "squares");
  v1::RayQuery query;
  query.set_wait(v1::BUILD_WAIT_FINAL);
  auto cast = std::async(std::launch::async, [&] {
    grpc::ClientContext context;
    v1::CastRaysRequest request;
    request.set_mesh("squares");
    *request.mutable_query() = query;
    request.mutable_rays()->set_rays(SlowRays(10));
    v1::CastRaysResponse response;
    return rays_->CastRays(&context, request, &response);
  });
  grpc::ClientContext context;
  auto stream = StreamOf(10, &context, query);
  EXPECT_EQ(cast.wait_for(std::chrono::milliseconds(200)), std::future_status::timeout);

  const auto start = std::chrono::steady_clock::now();
  EXPECT_TRUE(server_->Drain());
  EXPECT_LT(std::chrono::steady_clock::now() - start, options_.drain_timeout / 2);
  for (const grpc::Status& status : {cast.get(), stream->Finish()}) {
    EXPECT_EQ(status.error_code(), StatusCode::UNAVAILABLE);
    EXPECT_THAT(status.error_message(), HasSubstr("draining"));
  }
  enough = true;
  server_.reset();  // before what its threads look at is gone
}

TEST_F(ServerTest, WatchersOfHealthDoNotHoldUpTheDrain) {
  Start();
  grpc::ClientContext context;
  const auto stub = grpc::health::v1::Health::NewStub(channel_);
  const auto watch = stub->Watch(&context, grpc::health::v1::HealthCheckRequest());
  grpc::health::v1::HealthCheckResponse response;
  ASSERT_TRUE(watch->Read(&response));
  const auto start = std::chrono::steady_clock::now();
  EXPECT_TRUE(server_->Drain());
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(3));
  while (watch->Read(&response)) {
  }
  watch->Finish();
}

TEST_F(ServerTest, ATakenPortFailsClearly) {
  Start();
  ServerOptions options = options_;
  options.listen = absl::StrCat("127.0.0.1:", server_->port());
  options.store.data_directory = directory_ + "/other";
  const auto second = Server::Start(options);
  EXPECT_EQ(second.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(second.status().message()), HasSubstr(options.listen));
}

// Its threads would inherit it.
TEST_F(ServerTest, DoesNotStartWhereArithmeticIsNotIeee) {
  options_.listen = "127.0.0.1:0";
  options_.store.data_directory = directory_;
  absl::Status status;
  std::thread([&] {
    std::fesetround(FE_UPWARD);
    status = Server::Start(options_).status();
  }).join();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(status.message()), HasSubstr("does not round to nearest"));
}

// Some 5 MB of zeros in 5 kB of gzip, and there is no end to it.
TEST_F(ServerTest, CompressedRequestsAreRefused) {
  Start();
  UploadSquares(1, 0, "squares");
  for (const grpc_compression_algorithm algorithm : {GRPC_COMPRESS_GZIP, GRPC_COMPRESS_DEFLATE}) {
    grpc::ClientContext context;
    context.set_compression_algorithm(algorithm);
    v1::CastRaysRequest request;
    request.set_mesh("squares");
    request.mutable_rays()->set_rays(std::string(24 * 200'000, 0));
    v1::CastRaysResponse response;
    EXPECT_EQ(rays_->CastRays(&context, request, &response).error_code(), StatusCode::UNIMPLEMENTED);
  }
}

TEST_F(ServerTest, MessagesOverTheLimitAreRefused) {
  options_.batch.max_message_bytes = 100'000;
  Start();
  UploadSquares(1, 0, "squares");
  v1::CastRaysRequest request;
  request.set_mesh("squares");
  v1::CastRaysResponse response;
  {
    grpc::ClientContext context;
    request.mutable_rays()->set_rays(SlowRays(4100));
    EXPECT_TRUE(rays_->CastRays(&context, request, &response).ok());
  }
  grpc::ClientContext context;
  request.mutable_rays()->set_rays(SlowRays(4200));
  EXPECT_EQ(rays_->CastRays(&context, request, &response).error_code(), StatusCode::RESOURCE_EXHAUSTED);
}

TEST_F(ServerTest, ChannelzIsThereWhereAskedFor) {
  Start();
  grpc::ByteBuffer response;
  EXPECT_EQ(CallRaw("/grpc.channelz.v1.Channelz/GetServers", "", &response).error_code(), StatusCode::UNIMPLEMENTED);
  server_.reset();
  options_.channelz = true;
  Start();
  EXPECT_TRUE(CallRaw("/grpc.channelz.v1.Channelz/GetServers", "", &response).ok());
}

TEST_F(ServerTest, ReflectionListsTheServices) {
  Start();
  grpc::ClientContext context;
  const auto stream = Reflection(&context);
  grpc::ByteBuffer reply;
  ASSERT_TRUE(stream->Read(&reply));
  grpc::Slice bytes;
  ASSERT_TRUE(reply.DumpToSingleSlice(&bytes).ok());
  const std::string text(reinterpret_cast<const char*>(bytes.begin()), bytes.size());
  EXPECT_THAT(text, HasSubstr("deltaray.v1.MeshService"));
  EXPECT_THAT(text, HasSubstr("deltaray.v1.RayService"));
  stream->WritesDone();
  stream->Finish();
}

// gRPC gives each a thread.
TEST_F(ServerTest, IdleReflectionStreamsTakeFewThreads) {
  Start();
  UploadSquares(1, 0, "squares");
  const auto threads = [] {
    const std::filesystem::directory_iterator tasks("/proc/self/task");
    return std::distance(begin(tasks), end(tasks));
  };
  const auto threads_before = threads();
  constexpr size_t kStreams = 100;
  std::vector<std::unique_ptr<grpc::ClientContext>> contexts(kStreams);
  std::vector<ReflectionStream> streams;
  for (auto& context : contexts) {
    context = std::make_unique<grpc::ClientContext>();
    ReflectionStream stream = Reflection(context.get());
    grpc::ByteBuffer reply;
    if (stream->Read(&reply)) {
      streams.push_back(std::move(stream));
      continue;
    }
    const grpc::Status refused = stream->Finish();
    EXPECT_EQ(refused.error_code(), StatusCode::RESOURCE_EXHAUSTED) << refused.error_message();
  }
  EXPECT_GE(streams.size(), 1u);
  EXPECT_LT(streams.size(), 20u);
  EXPECT_LT(threads(), threads_before + 30);
  EXPECT_EQ(Health(""), "SERVING");
  v1::CastRaysRequest request;
  request.set_mesh("squares");
  request.mutable_rays()->set_rays(SlowRays(1));
  grpc::ClientContext cast_context;
  v1::CastRaysResponse response;
  EXPECT_TRUE(rays_->CastRays(&cast_context, request, &response).ok());
  for (const auto& stream : streams) {
    stream->WritesDone();
    EXPECT_TRUE(stream->Finish().ok());
  }
}

}  // namespace
}  // namespace deltaray
