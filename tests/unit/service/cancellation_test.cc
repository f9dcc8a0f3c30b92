// Work for clients that have gone, or do not want it any more, stops soon.

#include <netinet/in.h>
#include <sys/socket.h>

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "grpcpp/create_channel_posix.h"
#include "gtest/gtest.h"
#include "server/service/tracer.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using std::chrono::milliseconds;
using std::chrono::steady_clock;
using testing::HasSubstr;

// Rays that take a millisecond each.
class CancellationTest : public RunningServer {
 protected:
  void StartSlow() {
    HookedStore::Hooks hooks;
    hooks.on_query = [this](size_t rays) {
      for (size_t i = 0; i < rays; ++i) {
        last_begun_ = steady_clock::now().time_since_epoch().count();
        ++rays_begun_;
        std::this_thread::sleep_for(milliseconds(1));
      }
    };
    Start(std::move(hooks));
    UploadSquares(1, 0, "squares");
  }

  v1::CastRaysRequest Request(v1::QueryKind kind) {
    v1::CastRaysRequest request;
    request.set_mesh("squares");
    request.mutable_query()->set_kind(kind);
    for (int i = 0; i < 4000; ++i)
      request.mutable_rays()->mutable_rays()->append(Bytes<float>({0.25f, 0.5f, 9, 0, 0, -1}));
    return request;
  }

  // A socket that is connected to the server.
  int ConnectedSocket() const {
    const int connection = socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in address = {};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(server_->port()));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(connection, reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
    return connection;
  }

  // Whether the server begins no ray later than 100 ms after the moment that `stop` returns; in one of some tries,
  // since other work on the machine may delay any one of them.
  bool StopsSoon(const std::function<steady_clock::time_point()>& stop) const {
    for (int i = 0; i < 5; ++i) {
      const steady_clock::time_point moment = stop();
      std::this_thread::sleep_for(milliseconds(400));
      const steady_clock::time_point last(steady_clock::duration(last_begun_.load()));
      if (last - moment < milliseconds(100)) return true;
    }
    return false;
  }

  std::atomic<steady_clock::rep> last_begun_{0};
  std::atomic<int> rays_begun_{0};
};

TEST_F(CancellationTest, SlowRaysStopSoonAfterTheClient) {
  StartSlow();
  for (const v1::QueryKind kind : {v1::QUERY_KIND_ALL_HITS, v1::QUERY_KIND_COUNT_HITS}) {
    EXPECT_TRUE(StopsSoon([&] {
      const int before = rays_begun_;
      grpc::ClientContext context;
      std::thread client([&] {
        v1::CastRaysResponse response;
        EXPECT_EQ(rays_->CastRays(&context, Request(kind), &response).error_code(), StatusCode::CANCELLED);
      });
      EXPECT_TRUE(Eventually([&] { return rays_begun_ > before; }));
      context.TryCancel();
      const auto cancelled = steady_clock::now();
      client.join();
      return cancelled;
    }));
  }
}

TEST_F(CancellationTest, ConnectionsThatBreakStopWorkToo) {
  StartSlow();
  EXPECT_TRUE(StopsSoon([&] {
    const int before = rays_begun_;
    const int connection = ConnectedSocket();
    const auto stub = v1::RayService::NewStub(grpc::CreateInsecureChannelFromFd("server", connection));
    grpc::ClientContext context;
    const auto stream = stub->StreamRays(&context);
    v1::StreamRaysRequest request;
    request.mutable_start()->set_mesh("squares");
    request.mutable_start()->mutable_query()->set_kind(v1::QUERY_KIND_COUNT_HITS);
    stream->Write(request);
    *request.mutable_rays() = Request(v1::QUERY_KIND_COUNT_HITS).rays();
    stream->Write(request);
    EXPECT_TRUE(Eventually([&] { return rays_begun_ > before; }));
    shutdown(connection, SHUT_RDWR);
    const auto broken = steady_clock::now();
    EXPECT_EQ(stream->Finish().error_code(), StatusCode::UNAVAILABLE);
    return broken;
  }));
}

TEST_F(CancellationTest, WorkStopsAtTheDeadlineOfTheCall) {
  StartSlow();
  EXPECT_TRUE(StopsSoon([&] {
    const int before = rays_begun_;
    const v1::CastRaysRequest request = Request(v1::QUERY_KIND_COUNT_HITS);
    grpc::ClientContext context;
    const auto deadline = steady_clock::now() + milliseconds(1000);
    context.set_deadline(std::chrono::system_clock::now() + milliseconds(1000));
    v1::CastRaysResponse response;
    EXPECT_EQ(rays_->CastRays(&context, request, &response).error_code(), StatusCode::DEADLINE_EXCEEDED);
    EXPECT_GT(rays_begun_, before);
    return deadline;
  }));
}

// Triangles in one plane, one on the other: a ray through them has to decide exactly which of them comes first, which
// takes milliseconds.
class SlowMeshTest : public CancellationTest {
 protected:
  void StartWithStack() {
    HookedStore::Hooks hooks;
    hooks.on_query = [this](size_t rays) {
      ++queries_begun_;
      small_begun_ += rays == kSmallBatch;
    };
    hooks.on_query_end = [this] { last_begun_ = steady_clock::now().time_since_epoch().count(); };
    Start(std::move(hooks));
    UploadSquares(1, 0, "squares");
    std::string obj;
    for (int i = 1; i <= 20'000; ++i) {
      absl::StrAppend(&obj, "v -1 -1 0\nv ", 4 + i * 0x1p-13, " -1 0\nv -1 ", 4 + i * 0x1p-14, " 0\nf -3 -2 -1\n");
    }
    v1::UploadHeader header;
    header.set_name("stack");
    v1::UploadMeshResponse response;
    const grpc::Status status = Upload(obj, header, &response, 100'000);
    ASSERT_TRUE(status.ok()) << status.error_message();
    ASSERT_EQ(Cast("stack", v1::QUERY_KIND_CLOSEST_HIT, 1), StatusCode::OK);
  }

  static v1::CastRaysRequest CastRequest(const std::string& mesh, v1::QueryKind kind, size_t rays) {
    v1::CastRaysRequest request;
    request.set_mesh(mesh);
    request.mutable_query()->set_kind(kind);
    request.mutable_query()->set_wait(v1::BUILD_WAIT_FINAL);
    request.mutable_rays()->set_rays(RaysDownwards(rays));
    return request;
  }
  StatusCode Cast(const std::string& mesh, v1::QueryKind kind, size_t rays, grpc::ClientContext* context) {
    v1::CastRaysResponse response;
    return rays_->CastRays(context, CastRequest(mesh, kind, rays), &response).error_code();
  }
  StatusCode Cast(const std::string& mesh, v1::QueryKind kind, size_t rays) {
    grpc::ClientContext context;
    return Cast(mesh, kind, rays, &context);
  }

  // Rays that are traced on a thread of gRPC at first, at once.
  static constexpr size_t kSmallBatch = 256;

  std::atomic<int> queries_begun_{0};
  std::atomic<int> small_begun_{0};
};

TEST_F(SlowMeshTest, ManyRaysAtOnceStopSoonAfterTheClient) {
  StartWithStack();
  for (const v1::QueryKind kind : {v1::QUERY_KIND_CLOSEST_HIT, v1::QUERY_KIND_ALL_HITS, v1::QUERY_KIND_COUNT_HITS}) {
    EXPECT_TRUE(StopsSoon([&] {
      const int before = queries_begun_;
      grpc::ClientContext context;
      std::thread client([&] { EXPECT_EQ(Cast("stack", kind, 4000, &context), StatusCode::CANCELLED); });
      EXPECT_TRUE(Eventually([&] { return queries_begun_ > before; }));
      context.TryCancel();
      const auto cancelled = steady_clock::now();
      client.join();
      return cancelled;
    })) << kind;
  }
}

// As many as would take all threads of gRPC.
TEST_F(SlowMeshTest, FewRaysHoldUpNoThreadOfGrpc) {
  StartWithStack();
  std::atomic<int> done{0};
  grpc::ClientContext contexts[8];
  std::vector<std::thread> clients;
  for (grpc::ClientContext& context : contexts) {
    clients.emplace_back([&] {
      v1::CastRaysResponse response;
      v1::RayService::NewStub(Connect())->CastRays(
          &context, CastRequest("stack", v1::QUERY_KIND_CLOSEST_HIT, kSmallBatch), &response);
      ++done;
    });
  }
  // Each begins once where it must not stay, and once more elsewhere.
  EXPECT_TRUE(Eventually([&] { return small_begun_ >= 16; }));
  grpc::ClientContext context;
  v1::GetMeshRequest request;
  request.set_mesh("stack");
  v1::GetMeshResponse response;
  EXPECT_TRUE(meshes_->GetMesh(&context, request, &response).ok());
  EXPECT_LT(done, 8);
  for (grpc::ClientContext& cast : contexts) cast.TryCancel();
  for (std::thread& client : clients) client.join();
}

TEST_F(SlowMeshTest, ShortBatchesDoNotWaitForThoseThatTurnOutLong) {
  StartWithStack();
  const int before = queries_begun_;
  grpc::ClientContext contexts[4];
  std::vector<std::thread> clients;
  for (grpc::ClientContext& context : contexts) {
    clients.emplace_back(
        [&] { EXPECT_EQ(Cast("stack", v1::QUERY_KIND_CLOSEST_HIT, 16'000, &context), StatusCode::CANCELLED); });
  }
  EXPECT_TRUE(Eventually([&] { return queries_begun_ >= before + 2; }));
  EXPECT_EQ(Cast("squares", v1::QUERY_KIND_CLOSEST_HIT, 1000), StatusCode::OK);
  for (grpc::ClientContext& context : contexts) context.TryCancel();
  for (std::thread& client : clients) client.join();
}

TEST_F(CancellationTest, CallsThatWaitedForATreeGiveTheirMemoryBack) {
  // Builds outlive the test's body.
  const auto hold = std::make_shared<std::atomic<bool>>(false);
  options_.store.on_delta_leaf = [hold] {
    while (*hold) std::this_thread::sleep_for(milliseconds(1));
  };
  options_.batch.max_message_bytes = 1 << 20;
  options_.batch_bytes = 4 << 20;
  Start();
  UploadSquares(1, 0, "ready");
  const auto cast = [this](const std::string& mesh, milliseconds timeout) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + timeout);
    v1::CastRaysRequest request = Request(v1::QUERY_KIND_CLOSEST_HIT);
    request.set_mesh(mesh);
    request.mutable_query()->set_wait(v1::BUILD_WAIT_FINAL);
    std::string& rays = *request.mutable_rays()->mutable_rays();
    while (rays.size() < 900'000) rays += rays.substr(0, 96'000);
    v1::CastRaysResponse response;
    return rays_->CastRays(&context, request, &response).error_code();
  };
  ASSERT_EQ(cast("ready", milliseconds(10'000)), StatusCode::OK);
  *hold = true;
  UploadSquares(100, 1000, "building");
  std::vector<std::thread> clients;
  for (int i = 0; i < 6; ++i) {
    clients.emplace_back([&] { EXPECT_NE(cast("building", milliseconds(500)), StatusCode::OK); });
  }
  for (std::thread& client : clients) client.join();
  EXPECT_EQ(cast("ready", milliseconds(5'000)), StatusCode::OK);
  *hold = false;
}

TEST(TracerTest, ShortTasksDoNotWaitForLongOnes) {
  std::atomic<bool> enough{false};
  std::atomic<int> between{0}, done{0};
  Tracer tracer(2);
  for (int i = 0; i < 2; ++i) {
    tracer.Enqueue([&] {
      while (!enough) {
        std::this_thread::sleep_for(milliseconds(1));
        tracer.RunShort();
        ++between;
      }
    });
  }
  ASSERT_TRUE(Eventually([&] { return between > 4; }));
  for (int i = 0; i < 100; ++i) {
    // Within itself, a short task runs no other one.
    tracer.EnqueueShort([&] {
      const int now = done;
      tracer.RunShort();
      done = now + 1;
    });
    ASSERT_TRUE(Eventually([&] { return done == i + 1; }));
  }
  enough = true;
  tracer.Stop();
  EXPECT_EQ(done, 100);
}

}  // namespace
}  // namespace deltaray
