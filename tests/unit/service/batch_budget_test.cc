#include "server/service/batch_budget.h"

#include <atomic>
#include <deque>
#include <random>
#include <thread>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/http_get.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using std::chrono::milliseconds;
using std::chrono::seconds;
using std::chrono::steady_clock;
using std::chrono::system_clock;
using testing::HasSubstr;
using Answer = BatchBudget::Answer;
using Share = BatchBudget::Share;

constexpr uint64_t kMega = 1 << 20;
const std::function<void()> kNothing = [] {};

class BatchBudgetTest : public testing::Test {
 protected:
  // Begins to work on a message at once.
  std::unique_ptr<Share> Working(uint64_t bytes) {
    auto share = std::make_unique<Share>(&budget_);
    EXPECT_EQ(share->Begin(bytes / 2, bytes, false, kNothing), Answer::kNow);
    return share;
  }
  void TickAfter(milliseconds time) { budget_.Tick(steady_clock::now() + time); }

  BatchBudget budget_{16 * kMega};
};

TEST_F(BatchBudgetTest, CountsEachStageAndGivesAllBack) {
  {
    Share share(&budget_);
    EXPECT_TRUE(share.Expect(4 * kMega, kNothing));
    EXPECT_EQ(budget_.used(), 4 * kMega);
    EXPECT_FALSE(budget_.IsTight());
    EXPECT_EQ(share.Begin(3 * kMega, 9 * kMega, false, kNothing), Answer::kNow);
    EXPECT_EQ(budget_.used(), 9 * kMega);
    EXPECT_TRUE(budget_.IsTight());
    share.Reply(2 * kMega, kNothing);
    EXPECT_EQ(budget_.used(), 2 * kMega);
  }
  EXPECT_EQ(budget_.used(), 0u);
}

TEST_F(BatchBudgetTest, LetsThoseThatWaitInInTurn) {
  auto first = Working(12 * kMega);
  std::mutex mutex;
  std::vector<int> order;
  const auto note = [&](int i) {
    return [&, i] {
      const std::lock_guard lock(mutex);
      order.push_back(i);
    };
  };
  Share large(&budget_), message(&budget_), fits(&budget_), small(&budget_);
  EXPECT_FALSE(large.Expect(8 * kMega, note(1)));
  EXPECT_EQ(message.Begin(kMega, 3 * kMega, false, note(2)), Answer::kLater);
  // There would be room for it, but then one that needs much would wait forever.
  EXPECT_FALSE(fits.Expect(kMega, note(3)));
  EXPECT_TRUE(small.Expect(BatchBudget::kFreeBytes, kNothing));
  first = nullptr;
  EXPECT_TRUE(Eventually([&] {
    const std::lock_guard lock(mutex);
    return order.size() == 3;
  }));
  EXPECT_THAT(order, testing::ElementsAre(1, 2, 3));
  EXPECT_EQ(budget_.used(), 12 * kMega + BatchBudget::kFreeBytes);
}

TEST_F(BatchBudgetTest, LetsOneThroughWithoutRoomWhileNobodyWorks) {
  // Nothing would ever be given back but by clients.
  auto reply = Working(15 * kMega);
  reply->Reply(15 * kMega, kNothing);
  Share first(&budget_), second(&budget_);
  EXPECT_EQ(first.Begin(kMega, 100 * kMega, false, kNothing), Answer::kNow);
  std::atomic<bool> granted{false};
  EXPECT_EQ(second.Begin(kMega, 2 * kMega, false, [&] { granted = true; }), Answer::kLater);
  first.Reply(0, kNothing);
  EXPECT_TRUE(Eventually([&] { return granted.load(); }));
}

TEST_F(BatchBudgetTest, RepliesThatNobodyTakesLetInNoMoreThanOneWithoutRoom) {
  std::vector<std::unique_ptr<Share>> untaken;
  for (int i = 0; i < 17; ++i) {
    untaken.push_back(Working(kMega));
    untaken.back()->Reply(kMega, kNothing);
  }
  EXPECT_EQ(budget_.used(), 17 * kMega);
  Share waiting(&budget_);
  std::atomic<bool> granted{false};
  EXPECT_EQ(waiting.Begin(0, kMega, true, [&] { granted = true; }), Answer::kLater);
  untaken.pop_back();
  EXPECT_FALSE(granted);
  untaken.pop_back();
  EXPECT_TRUE(Eventually([&] { return granted.load(); }));
}

TEST_F(BatchBudgetTest, ClientsThatKeepSilentKeepNoRoom) {
  auto worker = Working(kMega);  // so that nobody is let through without room
  Share silent(&budget_), other(&budget_);
  const uint64_t first_expectation = budget_.first_expectation();
  EXPECT_TRUE(silent.Expect(15 * kMega, kNothing));
  std::atomic<bool> granted{false};
  EXPECT_FALSE(other.Expect(8 * kMega, [&] { granted = true; }));
  TickAfter(BatchBudget::kPatience / 2);
  EXPECT_FALSE(granted);
  TickAfter(BatchBudget::kPatience);
  EXPECT_TRUE(Eventually([&] { return granted.load(); }));
  EXPECT_EQ(budget_.first_expectation(), first_expectation / 2);
  worker = nullptr;
  // It speaks after all, of more than was expected of anyone.
  EXPECT_EQ(silent.Begin(kMega, 6 * kMega, false, kNothing), Answer::kNow);
  EXPECT_EQ(budget_.first_expectation(), 6 * kMega);
}

TEST_F(BatchBudgetTest, TheClientThatReadsLeastLosesItsReply) {
  auto worker = Working(kMega);  // so that nobody is let through without room
  std::atomic<int> lost{0}, granted{0};
  Share slow(&budget_), reading(&budget_), waiting(&budget_);
  for (Share* share : {&slow, &reading}) ASSERT_EQ(share->Begin(0, 7 * kMega, false, kNothing), Answer::kNow);
  slow.Reply(7 * kMega, [&] { lost += 1; });
  std::this_thread::sleep_for(milliseconds(10));
  reading.Reply(7 * kMega, [&] { lost += 100; });
  EXPECT_FALSE(waiting.Expect(5 * kMega, [&] { ++granted; }));
  TickAfter(BatchBudget::kStall / 2);
  EXPECT_EQ(lost, 0);
  reading.NoteProgress();
  TickAfter(BatchBudget::kStall + milliseconds(1));
  EXPECT_TRUE(Eventually([&] { return lost != 0; }));
  EXPECT_EQ(lost, 1);
  EXPECT_EQ(granted, 0);
}

TEST_F(BatchBudgetTest, RefusesWhoMayBeRefusedOnceTooMuchWaits) {
  auto worker = Working(16 * kMega);
  Share first(&budget_), second(&budget_), third(&budget_), patient(&budget_);
  EXPECT_EQ(first.Begin(3 * kMega, 5 * kMega, true, kNothing), Answer::kLater);
  EXPECT_EQ(second.Begin(2 * kMega, 5 * kMega, true, kNothing), Answer::kNever);
  EXPECT_EQ(patient.Begin(2 * kMega, 5 * kMega, false, kNothing), Answer::kLater);
  first.Withdraw();
  EXPECT_EQ(third.Begin(4 * kMega, 5 * kMega, true, kNothing), Answer::kLater);
}

// Many batches of all sizes, whose clients are slow, silent or gone: all that wait get their turn, and the sum is held.
TEST_F(BatchBudgetTest, NobodyIsForgotten) {
  constexpr int kClients = 16;
  constexpr uint64_t kLargest = 6 * kMega;
  std::atomic<bool> done{false};
  std::atomic<uint64_t> most{0}, batches{0};
  std::thread ticks([&] {
    while (!done) {
      budget_.Tick(steady_clock::now());
      uint64_t used = budget_.used();
      if (used > most) most = used;
      std::this_thread::sleep_for(milliseconds(1));
    }
  });
  std::vector<std::thread> clients;
  for (int client = 0; client < kClients; ++client) {
    clients.emplace_back([&, client] {
      std::mt19937 random(client);
      for (int i = 0; i < 150; ++i) {
        const uint64_t bytes = random() % kLargest;
        auto share = std::make_shared<Share>(&budget_);
        const auto granted = std::make_shared<std::atomic<bool>>(false);
        const auto grant = [granted] { *granted = true; };
        if (random() % 8 != 0 && !share->Expect(bytes, grant)) {
          if (random() % 8 == 0) continue;  // gone while it waits
          ASSERT_TRUE(Eventually([&] { return granted->load(); }));
        }
        *granted = false;
        const bool grows = random() % 4 == 0;
        if (share->Begin(bytes / 2, grows ? bytes + kMega : bytes, false, grant) == Answer::kLater) {
          ASSERT_TRUE(Eventually([&] { return granted->load(); }));
        }
        if (random() % 16 == 0) continue;  // gone while it is worked on
        share->Reply(bytes / 3, kNothing);
        if (random() % 16 == 0) std::this_thread::sleep_for(milliseconds(5));
        ++batches;
      }
    });
  }
  for (std::thread& client : clients) client.join();
  done = true;
  ticks.join();
  EXPECT_EQ(budget_.used(), 0u);
  EXPECT_GT(batches, kClients * 100u);
  // What was granted, one without room, small ones, and messages that were there before there was room.
  EXPECT_LT(most, 16 * kMega + kLargest + kClients * (BatchBudget::kFreeBytes + kLargest / 2));
}

class BudgetedServerTest : public RunningServer {
 protected:
  static constexpr size_t kRays = 5000;

  static std::string Rays() {
    std::string rays;
    for (size_t i = 0; i < kRays; ++i) rays += Bytes<float>({0.25f, 0.5f, 9, 0, 0, -1});
    return rays;
  }

  // The least that there is: 256 KiB, where a batch takes 205 KB.
  void StartSmall() {
    options_.batch.max_message_bytes = 1 << 18;
    options_.batch_bytes = 1;
    Start();
    UploadSquares(1, 0, "squares");
  }
};

TEST_F(BudgetedServerTest, StreamsAndCallsBeyondTheBudgetWaitForEachOther) {
  StartSmall();
  const std::string rays = Rays();
  std::atomic<int> answered{0};
  std::vector<std::thread> clients;
  for (int client = 0; client < 24; ++client) {
    clients.emplace_back([&, client] {
      const auto channel = Connect();
      // gRPC 1.51 gives up a first try with a stray errno where a thread waits for an absl::Mutex for the first time in
      // the process just then; it tries again.
      EXPECT_TRUE(channel->WaitForConnected(system_clock::now() + seconds(20)));
      const auto stub = v1::RayService::NewStub(channel);
      grpc::ClientContext context;
      if (client % 6 == 0) {
        v1::CastRaysRequest request;
        request.set_mesh("squares");
        request.mutable_rays()->set_rays(rays);
        v1::CastRaysResponse response;
        const grpc::Status status = stub->CastRays(&context, request, &response);
        // A few may be told to come later.
        EXPECT_TRUE(status.ok() || status.error_code() == StatusCode::RESOURCE_EXHAUSTED) << status.error_message();
        return;
      }
      auto stream = stub->StreamRays(&context);
      v1::StreamRaysRequest request;
      request.mutable_start()->set_mesh("squares");
      stream->Write(request);
      request.mutable_rays()->set_rays(rays);
      std::thread writer([&] {
        for (int i = 0; i < 10 && stream->Write(request);) ++i;
        stream->WritesDone();
      });
      v1::StreamRaysResponse response;
      while (stream->Read(&response)) {
        answered += response.hits().ray_count() == kRays;
        if (client % 4 == 1) std::this_thread::sleep_for(milliseconds(20));  // a slow reader
      }
      writer.join();
      const grpc::Status status = stream->Finish();
      EXPECT_TRUE(status.ok()) << status.error_message();
    });
  }
  for (std::thread& client : clients) client.join();
  EXPECT_EQ(answered, 20 * 10);
}

TEST_F(BudgetedServerTest, AStreamThatTakesNoRepliesGivesWayToOthers) {
  StartSmall();
  const std::string rays = Rays();
  std::vector<std::unique_ptr<grpc::ClientContext>> contexts;
  std::vector<std::unique_ptr<grpc::ClientReaderWriter<v1::StreamRaysRequest, v1::StreamRaysResponse>>> stalled;
  std::vector<std::shared_ptr<grpc::Channel>> channels;
  for (int i = 0; i < 16; ++i) {
    channels.push_back(Connect());
    contexts.push_back(std::make_unique<grpc::ClientContext>());
    stalled.push_back(v1::RayService::NewStub(channels.back())->StreamRays(contexts.back().get()));
    v1::StreamRaysRequest request;
    request.mutable_start()->set_mesh("squares");
    stalled.back()->Write(request);
    request.mutable_rays()->set_rays(rays);
    stalled.back()->Write(request);
  }
  // Within the 5 s that the others are given.
  for (int i = 0; i < 10; ++i) {
    grpc::ClientContext context;
    v1::CastRaysRequest request;
    request.set_mesh("squares");
    request.mutable_rays()->set_rays(rays);
    v1::CastRaysResponse response;
    const grpc::Status status = rays_->CastRays(&context, request, &response);
    EXPECT_TRUE(status.ok()) << status.error_message();
  }
  for (const auto& context : contexts) context->TryCancel();
  for (const auto& stream : stalled) stream->Finish();
}

TEST_F(BudgetedServerTest, MeshesThatNobodyReadsTakeABoundedPart) {
  options_.batch.max_message_bytes = 16 * kMega;
  options_.batch_bytes = 1;  // 64 MiB
  options_.metrics_listen = "127.0.0.1:0";
  Start();
  // 3 MiB of names of groups.
  std::string obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  for (int i = 0; i < 3072; ++i) absl::StrAppend(&obj, "g ", std::string(1019, 'a'), 1000 + i, "\nf 1 2 3\n");
  v1::UploadHeader header;
  header.set_name("groups");
  v1::UploadMeshResponse uploaded;
  const grpc::Status upload = Upload(obj, header, &uploaded, 1 << 20);
  ASSERT_TRUE(upload.ok()) << upload.error_message();

  // The value of a line of the metrics.
  const auto metric = [this](const std::string& name) {
    const std::string page = HttpGet(server_->metrics_port(), "/metrics");
    const size_t at = page.find(absl::StrCat("\n", name, " "));
    return at == std::string::npos ? -1 : std::stod(page.substr(at + name.size() + 2));
  };
  v1::GetMeshRequest request;
  request.set_mesh("groups");
  grpc::Slice slice(request.SerializeAsString());
  const grpc::ByteBuffer bytes(&slice, 1);
  // Else gRPC would take megabytes that nobody asks it for.
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_HTTP2_BDP_PROBE, 0);
  const auto channel = Connect(arguments);
  std::vector<std::unique_ptr<grpc::ClientContext>> contexts;
  std::vector<std::unique_ptr<grpc::ClientReader<grpc::ByteBuffer>>> unread;
  for (int i = 0; i < 100; ++i) {
    contexts.push_back(std::make_unique<grpc::ClientContext>());
    unread.emplace_back(grpc::internal::ClientReaderFactory<grpc::ByteBuffer>::Create(
        channel.get(),
        grpc::internal::RpcMethod("/deltaray.v1.MeshService/GetMesh", grpc::internal::RpcMethod::SERVER_STREAMING),
        contexts.back().get(), bytes));
  }
  EXPECT_TRUE(Eventually(
      [&] { return metric("deltaray_calls_total{code=\"RESOURCE_EXHAUSTED\",method=\"MeshService/GetMesh\"}") >= 70; },
      seconds(60)));
  EXPECT_LE(metric("deltaray_batch_bytes"), (64 + 16 + 2 * 4) * kMega);
  // Others have their turn once those have lost theirs.
  grpc::Status got;
  EXPECT_TRUE(Eventually(
      [&] {
        grpc::ClientContext context;
        v1::GetMeshResponse response;
        got = v1::MeshService::NewStub(Connect())->GetMesh(&context, request, &response);
        return got.ok() && response.mesh().groups_size() == 3072;
      },
      seconds(60)))
      << got.error_message();
  // And the metrics call none of them well.
  EXPECT_LE(metric("deltaray_calls_total{code=\"OK\",method=\"MeshService/GetMesh\"}"), 1);
  for (const auto& context : contexts) context->TryCancel();
  for (const auto& reader : unread) reader->Finish();
}

}  // namespace
}  // namespace deltaray
