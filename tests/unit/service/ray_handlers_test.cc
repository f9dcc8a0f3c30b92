#include "server/service/ray_handlers.h"

#include <atomic>
#include <fstream>
#include <future>
#include <limits>
#include <random>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "oneapi/tbb/task_arena.h"
#include "server/service/stream_call.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

// Rays downwards on squares, of which the one at `index` hits t = 100 - (top square) only if it is so.
std::string Downwards(size_t count, float height = 100) {
  std::vector<float> rays;
  for (size_t i = 0; i < count; ++i) {
    for (float number : {0.25f, 0.5f, height, 0.0f, 0.0f, -1.0f}) rays.push_back(number);
  }
  return Bytes(rays);
}

class RayHandlersTest : public RunningServer {
 protected:
  using RawStream = grpc::ClientReaderWriter<grpc::ByteBuffer, grpc::ByteBuffer>;
  using Stream = grpc::ClientReaderWriter<v1::StreamRaysRequest, v1::StreamRaysResponse>;

  grpc::Status Cast(const v1::CastRaysRequest& request, v1::CastRaysResponse* response) {
    grpc::ClientContext context;
    return rays_->CastRays(&context, request, response);
  }

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

TEST_F(RayHandlersTest, CastsAllKindsAsBruteForceDoes) {
  Start();
  const std::string id = UploadSquares(10, 0, "squares");
  std::mt19937 random(3);
  std::uniform_real_distribution<float> unit(-0.5f, 1.5f), slope(-0.05f, 0.05f);
  // 100 rays are answered within the reaction, 5000 on the arena.
  for (size_t count : {0, 1, 100, 5000}) {
    v1::RayBatch batch;
    for (size_t i = 0; i < count; ++i) {
      batch.mutable_rays()->append(Bytes<float>({unit(random), unit(random), 20, slope(random), slope(random), -1}));
      const uint32_t excluded = i % 3 == 0 ? static_cast<uint32_t>(i % 20) : kNoPrimitive;
      batch.mutable_excluded_primitive_ids()->append(Bytes<uint32_t>({excluded}));
    }
    for (int kind = v1::QUERY_KIND_CLOSEST_HIT; kind <= v1::QUERY_KIND_COUNT_HITS; ++kind) {
      v1::CastRaysRequest request;
      request.set_mesh("squares");
      *request.mutable_rays() = batch;
      request.mutable_query()->set_kind(static_cast<v1::QueryKind>(kind));
      request.mutable_query()->set_culling(v1::CULLING_BACK);
      request.mutable_query()->set_wait(v1::BUILD_WAIT_FINAL);
      v1::CastRaysResponse response;
      const grpc::Status status = Cast(request, &response);
      ASSERT_TRUE(status.ok()) << status.error_message();
      EXPECT_EQ(response.mesh_id(), id);
      EXPECT_TRUE(response.hits().final_tree());
      const auto expected = AnswerBatch(*BruteForceSnapshot(Squares(10)), *ReadQuery(request.query()),
                                        CopyRayBatch(batch), {}, [] { return false; });
      ASSERT_TRUE(expected.ok()) << expected.status();
      ASSERT_EQ(response.hits().SerializeAsString(), ToHitBatch(expected->hits).SerializeAsString())
          << count << " of kind " << kind;
    }
  }
}

TEST_F(RayHandlersTest, CastsOnTheBunnyOfEachBuilder) {
  std::ifstream file("/usr/share/glmark2/models/bunny.obj", std::ios::binary);
  if (!file) GTEST_SKIP() << "glmark2-data is not installed";
  const std::string bunny{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  Start();
  v1::UploadHeader header;
  header.set_name("bunny");
  v1::UploadMeshResponse uploaded;
  ASSERT_TRUE(Upload(bunny, header, &uploaded, 1 << 20).ok());
  EXPECT_EQ(uploaded.mesh().triangle_count(), 69'666u);
  // From above through the middle; answered while the tree is being built, and after.
  const v1::Bounds& bounds = uploaded.mesh().bounds();
  v1::CastRaysRequest request;
  request.set_mesh("bunny");
  request.mutable_query()->set_layout(v1::RAY_LAYOUT_FLOAT64X6);
  for (int i = 0; i < 2000; ++i) {
    const double s = (i % 50 + 0.5) / 50, r = (i / 50 + 0.5) / 40;
    request.mutable_rays()->mutable_rays()->append(
        Bytes<double>({bounds.min().x() + s * (bounds.max().x() - bounds.min().x()), bounds.max().y() + 1,
                       bounds.min().z() + r * (bounds.max().z() - bounds.min().z()), 0, -1, 0}));
  }
  v1::CastRaysResponse early;
  ASSERT_TRUE(Cast(request, &early).ok());
  int hits = 0;
  for (char flag : early.hits().flags()) hits += flag & 1;
  EXPECT_GT(hits, 500);
  EXPECT_LT(hits, 2000);

  const auto stats = [this] {
    grpc::ClientContext context;
    v1::GetBuildStatsRequest request;
    request.set_mesh("bunny");
    v1::GetBuildStatsResponse response;
    EXPECT_TRUE(meshes_->GetBuildStats(&context, request, &response).ok());
    return response.stats();
  };
  EXPECT_GT(stats().first_answer_seconds(), 0);

  request.mutable_query()->set_wait(v1::BUILD_WAIT_FINAL);
  for (int builder = v1::TREE_BUILDER_HYBRID; builder <= v1::TREE_BUILDER_TANG2015; ++builder) {
    SCOPED_TRACE(builder);
    grpc::ClientContext context;
    v1::RebuildMeshRequest rebuild;
    rebuild.set_mesh("bunny");
    rebuild.mutable_build_options()->set_builder(static_cast<v1::TreeBuilder>(builder));
    v1::RebuildMeshResponse rebuilt;
    ASSERT_TRUE(meshes_->RebuildMesh(&context, rebuild, &rebuilt).ok());
    // Until then the tree before answers.
    const auto is_built = [&] { return stats().options().builder() == builder && stats().total_seconds() > 0; };
    ASSERT_TRUE(Eventually(is_built, std::chrono::minutes(4)));
    v1::CastRaysResponse late;
    ASSERT_TRUE(Cast(request, &late).ok());
    EXPECT_TRUE(late.hits().final_tree());
    EXPECT_EQ(early.hits().t(), late.hits().t());
    EXPECT_EQ(early.hits().primitive_id(), late.hits().primitive_id());
  }
}

TEST_F(RayHandlersTest, CastErrorsNameFieldAndRay) {
  options_.batch.max_rays = 1000;
  Start();
  UploadSquares(1, 0, "squares");
  v1::CastRaysRequest request;
  v1::CastRaysResponse response;
  request.set_mesh("nobody");
  EXPECT_EQ(Cast(request, &response).error_code(), StatusCode::NOT_FOUND);
  request.set_mesh("squares");
  request.mutable_query()->set_kind(static_cast<v1::QueryKind>(9));
  EXPECT_EQ(Cast(request, &response).error_message(), "query.kind: 9 is not a value of the enum");
  request.clear_query();
  request.mutable_rays()->set_rays("123");
  EXPECT_THAT(Cast(request, &response).error_message(), HasSubstr("rays.rays: 3 bytes are not a multiple of 24"));
  request.mutable_rays()->set_rays(Downwards(1) + Bytes<float>({0, 0, 0, 1, NAN, 0}));
  EXPECT_EQ(Cast(request, &response).error_message(), "rays.rays: ray 1: direction.y is NaN");
  request.mutable_rays()->set_rays(Downwards(1001));
  const grpc::Status status = Cast(request, &response);
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(status.error_message(), "rays.rays: 1001 rays are over the limit of 1000 rays a batch (--max-batch-rays)");
}

TEST_F(RayHandlersTest, AnswersThousandsOfBatchesInOrder) {
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
      stream->Write(RaysMessage(Downwards(i % 7 == 0 ? 1000 : i % 5, static_cast<float>(100 + i))));
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

TEST_F(RayHandlersTest, MalformedMessagesEndTheStreamAfterTheRepliesBefore) {
  Start();
  UploadSquares(1, 0, "squares");
  const std::string start = StartMessage("squares").SerializeAsString();
  const std::string rays = RaysMessage(Downwards(3)).SerializeAsString();
  const std::string large = RaysMessage(Downwards(5000)).SerializeAsString();
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

TEST_F(RayHandlersTest, TheFirstMessageMustBeAValidStart) {
  Start();
  UploadSquares(1, 0, "squares");
  int replies;
  std::string batches;
  EXPECT_THAT(StreamRaw({}, &replies, &batches).error_message(), HasSubstr("no first message"));
  EXPECT_EQ(batches, "0");
  EXPECT_THAT(StreamRaw({"\xff"}, &replies, &batches).error_message(), HasSubstr("malformed message"));
  EXPECT_EQ(StreamRaw({RaysMessage(Downwards(1)).SerializeAsString()}, &replies, &batches).error_message(),
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

TEST_F(RayHandlersTest, ReadsNoFurtherAheadThanItsBound) {
  std::atomic<size_t> traced{0};
  HookedStore::Hooks hooks;
  hooks.on_query = [&traced](size_t rays) { traced += rays; };
  Start(hooks);
  UploadSquares(1, 0, "squares");
  grpc::ClientContext context;
  auto stream = rays_->StreamRays(&context);
  // 2.4 MB of rays and 2.1 MB of reply a batch, 64 times: far more than flow control and the line hold. Nobody reads
  // the replies.
  constexpr size_t kRays = 100'000;
  constexpr int kBatches = 64;
  v1::RayQuery query;
  query.set_kind(v1::QUERY_KIND_CLOSEST_HIT);
  stream->Write(StartMessage("squares", query));
  const v1::StreamRaysRequest batch = RaysMessage(Downwards(kRays));
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

TEST_F(RayHandlersTest, ACancelledStreamSoonStopsTracing) {
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
  stream->Write(RaysMessage(Downwards(1'000'000)));  // about 1000 pieces, 2.5 s on two threads
  ASSERT_TRUE(Eventually([&] { return pieces > 3; }));
  context.TryCancel();
  EXPECT_EQ(stream->Finish().error_code(), StatusCode::CANCELLED);
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  const int after = pieces;
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_EQ(pieces, after);
  EXPECT_LT(after, 500);
}

TEST_F(RayHandlersTest, SurvivesClientsThatGoAtAnyMoment) {
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
    const v1::StreamRaysRequest batch = RaysMessage(Downwards(random() % 2000));
    v1::StreamRaysResponse response;
    while (stream->Write(batch)) {
      if (random() % 2 == 0 && !stream->Read(&response)) break;
    }
    canceller.join();
    EXPECT_EQ(stream->Finish().error_code(), StatusCode::CANCELLED);
  }
  v1::CastRaysRequest request;
  request.set_mesh("squares");
  request.mutable_rays()->set_rays(Downwards(1));
  v1::CastRaysResponse response;
  EXPECT_TRUE(Cast(request, &response).ok());
}

TEST_F(RayHandlersTest, AStreamStaysWithItsMeshWhenTheNameMoves) {
  Start();
  const std::string a = UploadSquares(1, 0, "mesh");
  grpc::ClientContext context;
  auto stream = rays_->StreamRays(&context);
  stream->Write(StartMessage("mesh"));
  stream->Write(RaysMessage(Downwards(1)));
  v1::StreamRaysResponse response;
  ASSERT_TRUE(stream->Read(&response));
  const std::string b = UploadSquares(1, 5, "mesh");
  ASSERT_NE(a, b);
  stream->Write(RaysMessage(Downwards(1)));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.mesh_id(), a);
  EXPECT_EQ(response.hits().t(), Bytes<float>({100}));

  // Once its mesh is deleted there is nothing to answer from.
  grpc::ClientContext delete_context;
  v1::DeleteMeshRequest remove;
  remove.set_mesh(a);
  v1::DeleteMeshResponse removed;
  ASSERT_TRUE(meshes_->DeleteMesh(&delete_context, remove, &removed).ok());
  stream->Write(RaysMessage(Downwards(1)));
  EXPECT_FALSE(stream->Read(&response));
  EXPECT_EQ(stream->Finish().error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(TrailingBatches(context), "2");
}

TEST_F(RayHandlersTest, ASmallBatchThatMayBuildIsNoReactionOfGrpc) {
  std::atomic<bool> by_the_tracer{false};
  HookedStore::Hooks hooks;
  hooks.on_query = [&](size_t) {
    by_the_tracer = tbb::this_task_arena::current_thread_index() != tbb::task_arena::not_initialized;
  };
  Start(hooks);
  for (const bool lazy : {false, true}) {
    v1::UploadHeader header;
    header.mutable_build_options()->set_lazy(lazy);
    v1::UploadMeshResponse uploaded;
    ASSERT_TRUE(Upload(SquaresObj(200, lazy ? 1 : 0), header, &uploaded).ok());
    v1::CastRaysRequest request;
    request.set_mesh(uploaded.mesh().id());
    request.mutable_query()->set_wait(v1::BUILD_WAIT_FINAL);
    request.mutable_rays()->set_rays(Downwards(1));
    v1::CastRaysResponse response;
    // The first one may wait for the build.
    for (int i = 0; i < 2; ++i) ASSERT_TRUE(Cast(request, &response).ok());
    EXPECT_EQ(by_the_tracer, lazy);
  }
}

TEST_F(RayHandlersTest, ABatchUnderWayOutlivesItsMesh) {
  std::promise<void> traced, deleted;
  std::shared_future<void> go = deleted.get_future().share();
  std::atomic<bool> first{true};
  HookedStore::Hooks hooks;
  hooks.on_query = [&](size_t) {
    if (first.exchange(false)) traced.set_value();
    go.wait();
  };
  Start(hooks);
  UploadSquares(1, 0, "mesh");
  v1::CastRaysRequest request;
  request.set_mesh("mesh");
  request.mutable_rays()->set_rays(Downwards(2000));
  v1::CastRaysResponse response;
  auto cast = std::async(std::launch::async, [&] { return Cast(request, &response); });
  traced.get_future().wait();
  grpc::ClientContext context;
  v1::DeleteMeshRequest remove;
  remove.set_mesh("mesh");
  v1::DeleteMeshResponse removed;
  EXPECT_TRUE(meshes_->DeleteMesh(&context, remove, &removed).ok());
  deleted.set_value();
  const grpc::Status status = cast.get();
  EXPECT_TRUE(status.ok()) << status.error_message();
  EXPECT_EQ(response.hits().t(), Bytes(std::vector<float>(2000, 100)));
}

}  // namespace
}  // namespace deltaray
