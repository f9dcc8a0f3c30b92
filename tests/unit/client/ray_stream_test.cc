#include "client/ray_stream.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <thread>

#include "client/exit_code.h"
#include "client/input_file.h"
#include "tests/unit/client/fake_server.h"
#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

class RayStreamTest : public ::testing::Test {
 protected:
  RayStreamTest() : session_(server_.address()), connection_(Connection::Open(session_.session())) {
    start_.mutable_query()->set_kind(v1::QUERY_KIND_CLOSEST_HIT);
    start_.mutable_query()->add_columns(v1::HIT_COLUMN_T);
  }

  // Sends `batches` batches; batch i has i % 5 + 1 rays whose t is 1, 2, … over the whole stream. Counts the answers
  // that are right.
  absl::Status Stream(uint64_t batches) {
    uint64_t sent = 0;
    float next_sent = 1;
    float next_expected = 1;
    return StreamBatches(
        *connection_, start_,
        [&](OutgoingBatch& batch) {
          if (sent == batches) return false;
          batch.ray_count = sent++ % 5 + 1;
          for (uint32_t i = 0; i < batch.ray_count; ++i) {
            const float ray[] = {0, 0, next_sent++, 0, 0, -1};
            batch.rays.mutable_rays()->append(reinterpret_cast<const char*>(ray), sizeof(ray));
          }
          return true;
        },
        [&](const v1::HitBatch& hits) {
          for (uint32_t i = 0; i < hits.ray_count(); ++i) {
            float t;
            std::memcpy(&t, hits.t().data() + i * sizeof(t), sizeof(t));
            right_ += t == next_expected++;
          }
          return absl::OkStatus();
        });
  }

  // Sends `batches` batches of a ray, then waits for input that never comes.
  absl::Status StreamWithSilentInput(uint64_t batches) {
    int pipe_ends[2];
    EXPECT_EQ(pipe(pipe_ends), 0);
    session_.SetInputFd(pipe_ends[0]);
    auto file = InputFile::Open("-", session_.session());
    const absl::Status status = StreamBatches(
        *connection_, start_,
        [&](OutgoingBatch& batch) -> absl::StatusOr<bool> {
          batch.ray_count = 1;
          batch.rays.set_rays(std::string(24, '\0'));
          if (batches-- > 0) return true;
          char byte;
          return file->Read(std::span(&byte, 1)).status();
        },
        [](const v1::HitBatch&) { return absl::OkStatus(); });
    close(pipe_ends[1]);
    return status;
  }

  FakeServer server_;
  TestSession session_;
  absl::StatusOr<Connection> connection_;
  v1::StreamStart start_;
  uint64_t right_ = 0;
};

TEST_F(RayStreamTest, AnswersFarMoreBatchesThanTheWindowInOrder) {
  ASSERT_TRUE(Stream(500).ok());
  EXPECT_EQ(right_, 100u * (1 + 2 + 3 + 4 + 5));
}

TEST_F(RayStreamTest, StreamWithoutBatchesIsFine) { EXPECT_TRUE(Stream(0).ok()); }

TEST_F(RayStreamTest, ReturnsTheServersErrorInMidStream) {
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "ray 3 is bad");
  server_.behaviour.fail_at_batch = 20;
  const absl::Status status = Stream(500);
  EXPECT_EQ(ExitCode(status), 64 + 3);
  EXPECT_EQ(status.message(), "ray 3 is bad");
}

TEST_F(RayStreamTest, TellsWhichRayOfTheInputARefusedBatchBeginsWith) {
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "batch 7: rays.rays: ray 1: bad");
  server_.behaviour.fail_at_batch = 7;
  // 1 + 2 + 3 + 4 + 5 + 1 + 2 rays before it.
  EXPECT_EQ(Stream(20).message(),
            "batch 7: rays.rays: ray 1: bad; batch 7 begins with ray 18 of the whole input, all counted from 0");
}

// The server ends while the sender waits for input that never comes.
TEST_F(RayStreamTest, ServersErrorWakesASenderThatWaitsForInput) {
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::UNAVAILABLE, "draining");
  server_.behaviour.fail_at_batch = 0;
  const absl::Status status = StreamWithSilentInput(0);
  EXPECT_EQ(ExitCode(status), 64 + 14);
  EXPECT_EQ(status.message(), "draining");
}

TEST_F(RayStreamTest, ErrorOfTheInputEndsTheStream) {
  int batches = 0;
  const absl::Status status = StreamBatches(
      *connection_, start_,
      [&](OutgoingBatch& batch) -> absl::StatusOr<bool> {
        if (++batches == 3) return LocalError("line 7 is bad");
        batch.ray_count = 1;
        batch.rays.set_rays(std::string(24, '\0'));
        return true;
      },
      [](const v1::HitBatch&) { return absl::OkStatus(); });
  EXPECT_EQ(status.message(), "line 7 is bad");
  EXPECT_EQ(ExitCode(status), 1);
}

TEST_F(RayStreamTest, ErrorOfTheOutputEndsTheStream) {
  const absl::Status status = StreamBatches(
      *connection_, start_,
      [](OutgoingBatch& batch) -> absl::StatusOr<bool> {  // without end
        batch.ray_count = 1;
        batch.rays.set_rays(std::string(24, '\0'));
        return true;
      },
      [](const v1::HitBatch&) { return LocalError("disk full"); });
  EXPECT_EQ(status.message(), "disk full");
}

TEST_F(RayStreamTest, StopEndsTheStream) {
  int answered = 0;
  const absl::Status status = StreamBatches(
      *connection_, start_,
      [](OutgoingBatch& batch) -> absl::StatusOr<bool> {
        batch.ray_count = 1;
        batch.rays.set_rays(std::string(24, '\0'));
        return true;
      },
      [&](const v1::HitBatch&) {
        if (++answered == 5) session_.stop.Fire();
        return absl::OkStatus();
      });
  EXPECT_EQ(ExitCode(status), 65);
  EXPECT_EQ(status.message(), "interrupted");
}

TEST_F(RayStreamTest, ChecksBatchNumbers) {
  server_.behaviour.first_batch_number = 1;
  EXPECT_EQ(Stream(3).message(), "the server's reply to batch 0 has the number 1");
}

TEST_F(RayStreamTest, ChecksTheServersCountOfBatches) {
  server_.behaviour.extra_batches = 1;
  EXPECT_EQ(Stream(3).message(), "the server counts 4 batches, but 3 were sent");
}

// An early end that gRPC reports as OK must not pass for success.
TEST_F(RayStreamTest, EarlyEndWithOkIsAnError) {
  server_.behaviour.fail_at_batch = 2;
  const absl::Status status = Stream(3);
  EXPECT_EQ(ExitCode(status), 1);
}

// All that was read is answered, but more is to come.
TEST_F(RayStreamTest, EndWithOkWhileTheInputWaitsIsAnError) {
  server_.behaviour.fail_at_batch = 1;
  const absl::Status status = StreamWithSilentInput(1);
  EXPECT_EQ(ExitCode(status), 1);
  EXPECT_EQ(status.message(), "the server ended the stream after 1 batches, before all were sent");
}

TEST_F(RayStreamTest, ChecksRayCounts) {
  bool first = true;
  const absl::Status status = StreamBatches(
      *connection_, start_,
      [&](OutgoingBatch& batch) -> absl::StatusOr<bool> {
        batch.ray_count = 2;
        batch.rays.set_rays(std::string(24, '\0'));
        return std::exchange(first, false);
      },
      [](const v1::HitBatch&) { return absl::OkStatus(); });
  EXPECT_EQ(status.message(), "the server's reply to batch 0 is for 1 rays, not 2");
}

// The server is lost at each 7th batch of a stream, and answers what was sent to it and not read.
TEST_F(RayStreamTest, LostStreamsAreResumedWithoutLossOrDouble) {
  session_.session().retry_seconds = 20;
  start_.set_mesh("bunny");
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::UNAVAILABLE, "draining");
  server_.behaviour.fail_at_batch = 7;
  server_.behaviour.stream_failures = 5;
  const absl::Status status = Stream(100);
  ASSERT_TRUE(status.ok()) << status;
  EXPECT_EQ(right_, 20u * (1 + 2 + 3 + 4 + 5));
  ASSERT_EQ(server_.ray_service.starts.size(), 6u);
  EXPECT_EQ(server_.ray_service.starts[0].mesh(), "bunny");
}

TEST_F(RayStreamTest, AResumedStreamAsksForTheMeshThatWasAnsweredFirst) {
  session_.session().retry_seconds = 20;
  start_.set_mesh("bunny");
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::INTERNAL, "Received RST_STREAM with error code 2");
  server_.behaviour.fail_at_batch = 2;
  server_.behaviour.stream_failures = 1;
  server_.behaviour.moved_mesh = "id of bunny";
  ASSERT_TRUE(Stream(5).ok());
  ASSERT_EQ(server_.ray_service.starts.size(), 2u);
  EXPECT_EQ(server_.ray_service.starts[1].mesh(), "id of bunny");
  EXPECT_EQ(server_.ray_service.last_metadata.find("deltaray-mesh")->second, "bunny");
}

TEST_F(RayStreamTest, AStreamThatIsAnsweredForTwoMeshesIsAnError) {
  session_.session().retry_seconds = 20;
  start_.set_mesh("bunny");
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::UNAVAILABLE, "draining");
  server_.behaviour.fail_at_batch = 2;
  server_.behaviour.stream_failures = 1;
  server_.behaviour.moved_mesh = "another";
  EXPECT_EQ(Stream(5).message(), "the server's reply to batch 2 is of another mesh");
}

TEST_F(RayStreamTest, GivesUpWhenNoAnswerComesInTime) {
  session_.session().retry_seconds = 2;
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::UNAVAILABLE, "draining");
  server_.behaviour.fail_at_batch = 0;
  const auto start = std::chrono::steady_clock::now();
  const absl::Status status = Stream(5);
  EXPECT_EQ(ExitCode(status), 64 + 14);
  EXPECT_EQ(status.message(), "draining");
  EXPECT_GT(server_.ray_service.starts.size(), 2u);
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(10));
}

TEST_F(RayStreamTest, OtherErrorsAreNotRetried) {
  session_.session().retry_seconds = 20;
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::INTERNAL, "a defect");
  server_.behaviour.fail_at_batch = 1;
  EXPECT_EQ(Stream(5).message(), "a defect");
  EXPECT_EQ(server_.ray_service.starts.size(), 1u);
}

TEST_F(RayStreamTest, StopEndsTheWaitForALostServer) {
  session_.session().retry_seconds = 3600;
  server_.behaviour.stream_status = grpc::Status(grpc::StatusCode::UNAVAILABLE, "draining");
  server_.behaviour.fail_at_batch = 0;
  std::thread stop([this] {
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    session_.stop.Fire();
  });
  EXPECT_FALSE(Stream(5).ok());
  stop.join();
}

}  // namespace
}  // namespace deltaray
