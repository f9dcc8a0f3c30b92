#include "server/service/metrics.h"

#include <chrono>
#include <future>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "prometheus/text_serializer.h"
#include "server/service/mesh_metrics.h"
#include "tests/unit/service/http_get.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using testing::HasSubstr;
using testing::Not;

class MetricsTest : public RunningServer {
 protected:
  MetricsTest() { options_.metrics_listen = "127.0.0.1:0"; }

  // Over a store of its own, whose builds are counted.
  void StartWhole() {
    absl::StatusOr<std::unique_ptr<Server>> server = Server::Start(options_);
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
    channel_ = Connect();
    meshes_ = v1::MeshService::NewStub(channel_);
    rays_ = v1::RayService::NewStub(channel_);
  }

  std::string Page() { return HttpGet(server_->metrics_port(), "/metrics"); }

  grpc::Status Cast(const std::string& mesh, size_t rays, v1::QueryKind kind) {
    grpc::ClientContext context;
    v1::CastRaysRequest request;
    request.set_mesh(mesh);
    request.mutable_query()->set_kind(kind);
    request.mutable_query()->set_wait(v1::BUILD_WAIT_FINAL);
    std::string bytes;
    for (size_t i = 0; i < rays; ++i) bytes += Bytes<float>({i % 2 == 0 ? 0.25f : 5.0f, 0.5f, 9, 0, 0, -1});
    request.mutable_rays()->set_rays(bytes);
    v1::CastRaysResponse response;
    return rays_->CastRays(&context, request, &response);
  }
};

TEST_F(MetricsTest, CountsRaysHitsCallsBuildsAndUploads) {
  StartWhole();
  const std::string id = UploadSquares(3, 0, "squares");
  ASSERT_TRUE(Cast("squares", 1000, v1::QUERY_KIND_CLOSEST_HIT).ok());
  ASSERT_TRUE(Cast("squares", 10, v1::QUERY_KIND_ANY_HIT).ok());
  ASSERT_TRUE(Cast("squares", 4, v1::QUERY_KIND_ALL_HITS).ok());
  ASSERT_TRUE(Cast("squares", 4, v1::QUERY_KIND_COUNT_HITS).ok());
  EXPECT_FALSE(Cast("triangles", 4, v1::QUERY_KIND_COUNT_HITS).ok());
  for (const char* line : {
           R"(deltaray_rays_total{kind="closest_hit",level="exact"} 1000)",
           R"(deltaray_hits_total{kind="closest_hit",level="exact"} 500)",
           R"(deltaray_batches_total{kind="closest_hit",level="exact"} 1)",
           R"(deltaray_batch_duration_seconds_count{kind="any_hit",level="exact"} 1)",
           R"(deltaray_hits_total{kind="any_hit",level="exact"} 5)",
           R"(deltaray_hits_total{kind="all_hits",level="exact"} 6)",
           R"(deltaray_hits_total{kind="count_hits",level="exact"} 6)",
           R"(deltaray_calls_total{code="OK",method="RayService/CastRays"} 4)",
           R"(deltaray_calls_total{code="NOT_FOUND",method="RayService/CastRays"} 1)",
           R"(deltaray_calls_total{code="INTERNAL",method="MeshService/GetMesh"} 0)",
           R"(deltaray_call_duration_seconds_count{code="OK",method="MeshService/UploadMesh"} 1)",
           R"(deltaray_calls_under_way{method="RayService/CastRays"} 0)",
           R"(deltaray_batches_waiting 0)",
           R"(deltaray_batches_tracing 0)",
           R"(deltaray_batch_bytes 0)",
           R"(deltaray_batch_limit_bytes )",
           R"(deltaray_builds_total{outcome="done"} 1)",
           R"(deltaray_build_duration_seconds_count 1)",
           R"(deltaray_build_phase_seconds_total{phase="top"})",
           R"(deltaray_meshes{state="ready"} 1)",
           R"(deltaray_memory_bytes{what="trees"})",
           R"(process_resident_memory_bytes)",
           R"(process_open_fds)",
       }) {
    // Calls and builds are counted a moment after their clients have been told of their end.
    EXPECT_TRUE(Eventually([&] { return Page().find(line) != std::string::npos; })) << line << '\n' << Page();
  }
  const std::string page = Page();
  EXPECT_THAT(page, HasSubstr(absl::StrCat("deltaray_upload_bytes_total ", SquaresObj(3).size())));
  EXPECT_THAT(page, HasSubstr(absl::StrCat("deltaray_mesh_rays_total{mesh=\"", id, "\"} 1018")));
  EXPECT_THAT(page, HasSubstr(absl::StrCat("deltaray_build_info{version=\"", DELTARAY_VERSION, "\"} 1")));
}

TEST_F(MetricsTest, SeriesOfADeletedMeshGoAway) {
  Start();
  const std::string id = UploadSquares(3, 0, "squares");
  ASSERT_TRUE(Cast("squares", 10, v1::QUERY_KIND_ANY_HIT).ok());
  EXPECT_THAT(Page(), HasSubstr(id));
  grpc::ClientContext context;
  v1::DeleteMeshRequest request;
  request.set_mesh(id);
  v1::DeleteMeshResponse response;
  ASSERT_TRUE(meshes_->DeleteMesh(&context, request, &response).ok());
  EXPECT_THAT(Page(), Not(HasSubstr(id)));
}

TEST_F(MetricsTest, ShowsBatchesBeingTracedAndStreamsUnderWay) {
  HeldQueries queries;
  Start(queries.hooks());
  UploadSquares(1, 0, "squares");
  auto cast = std::async(std::launch::async, [&] { return Cast("squares", 2000, v1::QUERY_KIND_ANY_HIT).ok(); });
  ASSERT_TRUE(queries.Await());
  const std::string page = Page();
  EXPECT_THAT(page, HasSubstr("deltaray_batches_tracing 1"));
  EXPECT_THAT(page, HasSubstr(R"(deltaray_calls_under_way{method="RayService/CastRays"} 1)"));
  queries.LetGo();
  EXPECT_TRUE(cast.get());
}

TEST_F(MetricsTest, ServesNothingButMetrics) {
  Start();
  EXPECT_THAT(HttpGet(server_->metrics_port(), "/"), HasSubstr("404"));
  EXPECT_THAT(HttpGet(server_->metrics_port(), "/etc/passwd"), HasSubstr("404"));
  EXPECT_THAT(HttpGet(server_->metrics_port(), "/../../../etc/passwd"), Not(HasSubstr("root:")));
}

TEST_F(MetricsTest, ATakenPortIsToldAtTheStart) {
  Start();
  ServerOptions second = options_;
  second.store.data_directory = directory_ + "/second";
  second.metrics_listen = absl::StrCat("127.0.0.1:", server_->metrics_port());
  const auto server = Server::Start(second);
  EXPECT_EQ(server.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(server.status().message()), HasSubstr("metrics"));
}

TEST(MeshMetricsTest, MeshesBeyondTheCapShareOneSeries) {
  prometheus::Registry registry;
  MeshMetrics metrics(registry);
  for (size_t i = 0; i < MeshMetrics::kMaxMeshes + 5; ++i) metrics.CountBatch(absl::StrCat("mesh", i), 10, 1);
  const auto page = [&registry] { return prometheus::TextSerializer().Serialize(registry.Collect()); };
  EXPECT_THAT(page(), HasSubstr(R"(deltaray_mesh_rays_total{mesh="other"} 50)"));
  EXPECT_THAT(page(), HasSubstr(absl::StrCat("{mesh=\"mesh", MeshMetrics::kMaxMeshes - 1, "\"} 10")));
  EXPECT_THAT(page(), Not(HasSubstr(absl::StrCat("{mesh=\"mesh", MeshMetrics::kMaxMeshes, "\"}"))));
  metrics.Prune([](const std::string& id) { return id != "mesh7"; });
  EXPECT_THAT(page(), Not(HasSubstr(R"({mesh="mesh7"})")));
  metrics.CountBatch("new", 3, 1);
  EXPECT_THAT(page(), HasSubstr(R"(deltaray_mesh_rays_total{mesh="new"} 3)"));
}

TEST(MetricsCostTest, ABatchCostsAFractionOfAMicrosecond) {
  Metrics metrics;
  CallRecord call;
  const std::string id(64, 'a');
  constexpr int kBatches = 100'000;
  const auto begin = std::chrono::steady_clock::now();
  for (int i = 0; i < kBatches; ++i) {
    BatchMeter meter(&metrics, &call);
    meter.BeginTracing();
    meter.CountAnswer({id, v1::QUERY_KIND_CLOSEST_HIT, AccuracyLevel::kExact, 64, 32});
  }
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  RecordProperty("nanoseconds_per_batch", absl::StrCat(seconds / kBatches * 1e9));
  std::printf("%.0f ns a batch\n", seconds / kBatches * 1e9);
  // Far more than it takes, for machines that are slow or busy; a call costs some 40 microseconds.
  EXPECT_LT(seconds / kBatches, 20e-6);
}

TEST_F(MetricsTest, TellsOfConnectionsAndOfThoseRefused) {
  options_.max_connections = 3;
  // Its look is a connection, too.
  options_.watchdog_interval = std::chrono::hours(1);
  StartWhole();
  const auto list = [](const std::shared_ptr<grpc::Channel>& channel) {
    grpc::ClientContext context;
    v1::ListMeshesResponse response;
    return v1::MeshService::NewStub(channel)->ListMeshes(&context, {}, &response).ok();
  };
  std::vector<std::shared_ptr<grpc::Channel>> channels = {channel_, Connect(), Connect()};
  for (const auto& channel : channels) EXPECT_TRUE(list(channel));
  std::string page = Page();
  EXPECT_THAT(page, HasSubstr("\ndeltaray_connections 3\n"));
  EXPECT_THAT(page, HasSubstr("\ndeltaray_connections_limit 3\n"));
  EXPECT_THAT(page, HasSubstr("\ndeltaray_connections_refused_total 0\n"));
  EXPECT_FALSE(list(Connect()));
  page = Page();
  EXPECT_THAT(page, HasSubstr("\ndeltaray_connections 3\n"));
  EXPECT_THAT(page, Not(HasSubstr("\ndeltaray_connections_refused_total 0\n")));
  channels.resize(2);
  EXPECT_TRUE(Eventually([&] { return Page().find("\ndeltaray_connections 2\n") != std::string::npos; }));
}

}  // namespace
}  // namespace deltaray
