// Calls of CastRays.

#include "server/service/ray_handlers.h"

#include <atomic>
#include <fstream>
#include <future>
#include <random>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "oneapi/tbb/task_arena.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

class RayHandlersTest : public RunningServer {
 protected:
  grpc::Status Cast(const v1::CastRaysRequest& request, v1::CastRaysResponse* response) {
    grpc::ClientContext context;
    return rays_->CastRays(&context, request, response);
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
      const auto expected =
          AnswerBatch(*BruteForceSnapshot(Squares(10)), *ReadQuery(request.query()), CopyRayBatch(batch), {}, {});
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
  request.mutable_rays()->set_rays(RaysDownwards(1) + Bytes<float>({0, 0, 0, 1, NAN, 0}));
  EXPECT_EQ(Cast(request, &response).error_message(), "rays.rays: ray 1: direction.y is NaN");
  request.mutable_rays()->set_rays(RaysDownwards(1001));
  const grpc::Status status = Cast(request, &response);
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(status.error_message(), "rays.rays: 1001 rays are over the limit of 1000 rays a batch (--max-batch-rays)");
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
    request.mutable_rays()->set_rays(RaysDownwards(1));
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
  request.mutable_rays()->set_rays(RaysDownwards(2000));
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
