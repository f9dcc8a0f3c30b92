// Calls of StreamRays.

#include "server/service/stream_call.h"

#include <atomic>
#include <random>
#include <thread>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

class StreamCallTest : public RunningServer {
 protected:
  using RawStream = grpc::ClientReaderWriter<grpc::ByteBuffer, grpc::ByteBuffer>;

  static v1::StreamRaysRequest StartMessage(const std::string& mesh, const v1::RayQuery& query = {}) {
    v1::StreamRaysRequest request;
    request.mutable_start()->set_mesh(mesh);
    *request.mutable_start()->mutable_query() = query;
    return request;
  }

  static v1::StreamRaysRequest RaysMessage(const std::string& rays) {
    v1::StreamRaysRequest request;
    request.mutable_rays()->set_rays(rays);
    return request;
  }

  // Sends messages of any bytes, and returns how the stream ended after how many replies.
  grpc::Status StreamRaw(const std::vector<std::string>& messages, int* replies, std::string* batches) {
    grpc::ClientContext context;
    std::unique_ptr<RawStream> stream(
        grpc::internal::ClientReaderWriterFactory<grpc::ByteBuffer, grpc::ByteBuffer>::Create(
            channel_.get(),
            grpc::internal::RpcMethod("/deltaray.v1.RayService/StreamRays", grpc::internal::RpcMethod::BIDI_STREAMING),
            &context));
    for (const std::string& message : messages) {
      grpc::Slice slice(message);
      stream->Write(grpc::ByteBuffer(&slice, 1));
    }
    stream->WritesDone();
    grpc::ByteBuffer reply;
    *replies = 0;
    while (stream->Read(&reply)) ++*replies;
    const grpc::Status status = stream->Finish();
    *batches = TrailingBatches(context);
    return status;
  }

  static std::string TrailingBatches(const grpc::ClientContext& context) {
    const auto& trailers = context.GetServerTrailingMetadata();
    const auto found = trailers.find("deltaray-batches");
    return found == trailers.end() ? "none" : std::string(found->second.data(), found->second.size());
  }
};

TEST_F(StreamCallTest, AnswersThousandsOfBatchesInOrder) {
  Start();
  const std::string id = UploadSquares(10, 0, "squares");
  grpc::ClientContext context;
  auto stream = rays_->StreamRays(&context);
  v1::RayQuery query;
  query.add_columns(v1::HIT_COLUMN_T);
  constexpr int kBatches = 3000;
  std::thread writer([&] {
    stream->Write(StartMessage("squares", query));
    // Batches of very different sizes, small ones and large ones in turn; each is known by the height of its rays.
    for (int i = 0; i < kBatches; ++i) {
      stream->Write(RaysMessage(RaysDownwards(i % 7 == 0 ? 1000 : i % 5, static_cast<float>(100 + i))));
    }
    stream->WritesDone();
  });
  v1::StreamRaysResponse response;
  int replies = 0;
  while (stream->Read(&response)) {
    ASSERT_EQ(response.batch_number(), static_cast<uint64_t>(replies));
    const size_t rays = replies % 7 == 0 ? 1000 : replies % 5;
    ASSERT_EQ(response.hits().t(), Bytes(std::vector<float>(rays, static_cast<float>(100 + replies - 9))));
    ASSERT_EQ(response.hits().ray_count(), rays);
    ASSERT_EQ(response.mesh_id(), id);
    ++replies;
  }
  writer.join();
  EXPECT_TRUE(stream->Finish().ok());
  EXPECT_EQ(replies, kBatches);
  EXPECT_EQ(TrailingBatches(context), absl::StrCat(kBatches));
}

TEST_F(StreamCallTest, MalformedMessagesEndTheStreamAfterTheRepliesBefore) {
  Start();
  UploadSquares(1, 0, "squares");
  const std::string start = StartMessage("squares").SerializeAsString();
  const std::string rays = RaysMessage(RaysDownwards(3)).SerializeAsString();
  const std::string large = RaysMessage(RaysDownwards(5000)).SerializeAsString();
  const std::string nan = RaysMessage(Bytes<float>({0, 0, 0, 0, 0, NAN})).SerializeAsString();
  int replies;
  std::string batches;

  grpc::Status status = StreamRaw({start, rays, large, "\x12\xff\xff", rays}, &replies, &batches);
  EXPECT_EQ(status.error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(status.error_message(), HasSubstr("batch 2: malformed message"));
  EXPECT_EQ(replies, 2);
  EXPECT_EQ(batches, "2");

  status = StreamRaw({start, large, nan, rays}, &replies, &batches);
  EXPECT_EQ(status.error_message(), "batch 1: rays.rays: ray 0: direction.z is NaN");
  EXPECT_EQ(replies, 1);
  EXPECT_EQ(batches, "1");

  status = StreamRaw({start, rays, start}, &replies, &batches);
  EXPECT_EQ(status.error_message(), "batch 1: all messages of the stream but the first one must hold rays");
  EXPECT_EQ(batches, "1");

  status = StreamRaw({start, ""}, &replies, &batches);
  EXPECT_EQ(status.error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(batches, "0");
}

TEST_F(StreamCallTest, TheFirstMessageMustBeAValidStart) {
  Start();
  UploadSquares(1, 0, "squares");
  int replies;
  std::string batches;
  EXPECT_THAT(StreamRaw({}, &replies, &batches).error_message(), HasSubstr("no first message"));
  EXPECT_EQ(batches, "0");
  EXPECT_THAT(StreamRaw({"\xff"}, &replies, &batches).error_message(), HasSubstr("malformed message"));
  EXPECT_EQ(StreamRaw({RaysMessage(RaysDownwards(1)).SerializeAsString()}, &replies, &batches).error_message(),
            "the first message of the stream must hold start");
  grpc::Status status = StreamRaw({StartMessage("nobody").SerializeAsString()}, &replies, &batches);
  EXPECT_EQ(status.error_code(), StatusCode::NOT_FOUND);
  EXPECT_THAT(status.error_message(), HasSubstr("nobody"));
  v1::RayQuery query;
  query.set_layout(static_cast<v1::RayLayout>(12));
  status = StreamRaw({StartMessage("squares", query).SerializeAsString()}, &replies, &batches);
  EXPECT_EQ(status.error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(status.error_message(), "start.query.layout: 12 is not a value of the enum");
  EXPECT_TRUE(StreamRaw({StartMessage("squares").SerializeAsString()}, &replies, &batches).ok());
}

TEST_F(StreamCallTest, ReadsNoFurtherAheadThanItsBound) {
  std::atomic<size_t> traced{0};
  HookedStore::Hooks hooks;
  hooks.on_query = [&traced](size_t rays) { traced += rays; };
  Start(hooks);
  UploadSquares(1, 0, "squares");
  // Its own probe for a larger window would let more through, as fast as the machine's loopback is.
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_HTTP2_BDP_PROBE, 0);
  const auto rays_service = v1::RayService::NewStub(Connect(arguments));
  grpc::ClientContext context;
  auto stream = rays_service->StreamRays(&context);
  // 2.4 MB of rays and 2.1 MB of reply a batch, 64 times: far more than flow control and the line hold. Nobody reads
  // the replies.
  constexpr size_t kRays = 100'000;
  constexpr int kBatches = 64;
  v1::RayQuery query;
  query.set_kind(v1::QUERY_KIND_CLOSEST_HIT);
  stream->Write(StartMessage("squares", query));
  const v1::StreamRaysRequest batch = RaysMessage(RaysDownwards(kRays));
  std::atomic<int> written{0};
  std::thread writer([&] {
    while (written < kBatches && stream->Write(batch)) ++written;
    stream->WritesDone();
  });
  // Once nothing moves any more, the server has stopped to read.
  int before = -1;
  size_t traced_before = 0;
  while (before != written || traced_before != traced) {
    before = written;
    traced_before = traced;
    std::this_thread::sleep_for(std::chrono::milliseconds(400));
  }
  EXPECT_LT(written, kBatches);
  // In line, being written, and what fits in the buffers of the connection, which grow with its speed.
  EXPECT_LE(traced, (StreamCall::kReadAhead + 12) * kRays);
  EXPECT_LE(static_cast<size_t>(written), StreamCall::kReadAhead + 24);

  v1::StreamRaysResponse response;
  int replies = 0;
  while (stream->Read(&response)) ++replies;
  writer.join();
  EXPECT_TRUE(stream->Finish().ok());
  EXPECT_EQ(replies, kBatches);
}

TEST_F(StreamCallTest, ACancelledStreamSoonStopsTracing) {
  std::atomic<int> pieces{0};
  HookedStore::Hooks hooks;
  hooks.on_query = [&pieces](size_t) {
    ++pieces;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  };
  Start(hooks);
  UploadSquares(1, 0, "squares");
  grpc::ClientContext context;
  auto stream = rays_->StreamRays(&context);
  stream->Write(StartMessage("squares"));
  stream->Write(RaysMessage(RaysDownwards(1'000'000)));  // about 1000 pieces, 2.5 s on two threads
  ASSERT_TRUE(Eventually([&] { return pieces > 3; }));
  context.TryCancel();
  EXPECT_EQ(stream->Finish().error_code(), StatusCode::CANCELLED);
  EXPECT_TRUE(Eventually([&] {
    const int now = pieces;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    return pieces == now;
  }));
  EXPECT_LT(pieces, 500);
}

TEST_F(StreamCallTest, SurvivesClientsThatGoAtAnyMoment) {
  Start();
  UploadSquares(3, 0, "squares");
  std::mt19937 random(11);
  for (int i = 0; i < 60; ++i) {
    grpc::ClientContext context;
    auto stream = rays_->StreamRays(&context);
    std::thread canceller([&context, delay = random() % 3000] {
      std::this_thread::sleep_for(std::chrono::microseconds(delay));
      context.TryCancel();
    });
    stream->Write(StartMessage("squares"));
    const v1::StreamRaysRequest batch = RaysMessage(RaysDownwards(random() % 2000));
    v1::StreamRaysResponse response;
    while (stream->Write(batch)) {
      if (random() % 2 == 0 && !stream->Read(&response)) break;
    }
    canceller.join();
    EXPECT_EQ(stream->Finish().error_code(), StatusCode::CANCELLED);
  }
  grpc::ClientContext context;
  v1::CastRaysRequest request;
  request.set_mesh("squares");
  request.mutable_rays()->set_rays(RaysDownwards(1));
  v1::CastRaysResponse response;
  EXPECT_TRUE(rays_->CastRays(&context, request, &response).ok());
}

TEST_F(StreamCallTest, AStreamStaysWithItsMeshWhenTheNameMoves) {
  Start();
  const std::string a = UploadSquares(1, 0, "mesh");
  grpc::ClientContext context;
  auto stream = rays_->StreamRays(&context);
  stream->Write(StartMessage("mesh"));
  stream->Write(RaysMessage(RaysDownwards(1)));
  v1::StreamRaysResponse response;
  ASSERT_TRUE(stream->Read(&response));
  const std::string b = UploadSquares(1, 5, "mesh");
  ASSERT_NE(a, b);
  stream->Write(RaysMessage(RaysDownwards(1)));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.mesh_id(), a);
  EXPECT_EQ(response.hits().t(), Bytes<float>({100}));

  // Once its mesh is deleted there is nothing to answer from.
  grpc::ClientContext delete_context;
  v1::DeleteMeshRequest remove;
  remove.set_mesh(a);
  v1::DeleteMeshResponse removed;
  ASSERT_TRUE(meshes_->DeleteMesh(&delete_context, remove, &removed).ok());
  stream->Write(RaysMessage(RaysDownwards(1)));
  EXPECT_FALSE(stream->Read(&response));
  EXPECT_EQ(stream->Finish().error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(TrailingBatches(context), "2");
}

}  // namespace
}  // namespace deltaray
