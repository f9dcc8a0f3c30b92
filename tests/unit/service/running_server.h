// A server in this process, over a store in a directory of its own, and clients of it.

#ifndef TESTS_UNIT_SERVICE_RUNNING_SERVER_H_
#define TESTS_UNIT_SERVICE_RUNNING_SERVER_H_

#include <stdlib.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "deltaray/v1/mesh_service.grpc.pb.h"
#include "deltaray/v1/ray_service.grpc.pb.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/impl/codegen/client_unary_call.h"
#include "gtest/gtest.h"
#include "server/service/server.h"
#include "tests/eventually.h"

namespace deltaray {

// Passes everything on to a tree, between two hooks.
class HookedTree final : public Tree {
 public:
  HookedTree(std::shared_ptr<const TreeSnapshot> inner, std::function<void(size_t rays)> begin,
             std::function<void()> end)
      : inner_(std::move(inner)), begin_(std::move(begin)), end_(std::move(end)) {}

  void ClosestHits(std::span<const Ray> rays, const QueryOptions& options, std::span<Hit> hits) const override {
    begin_(rays.size());
    inner_->tree->ClosestHits(rays, options, hits);
    end_();
  }
  void AnyHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint8_t> any) const override {
    begin_(rays.size());
    inner_->tree->AnyHits(rays, options, any);
    end_();
  }
  void AllHits(std::span<const Ray> rays, const QueryOptions& options, std::vector<Hit>* hits,
               std::span<uint32_t> counts) const override {
    begin_(rays.size());
    inner_->tree->AllHits(rays, options, hits, counts);
    end_();
  }
  void CountHits(std::span<const Ray> rays, const QueryOptions& options, std::span<uint32_t> counts) const override {
    begin_(rays.size());
    inner_->tree->CountHits(rays, options, counts);
    end_();
  }
  AccuracyLevel answered_accuracy(AccuracyLevel level) const override { return inner_->tree->answered_accuracy(level); }
  bool is_growing() const override { return inner_->tree->is_growing(); }
  TreeShape Shape() const override { return inner_->tree->Shape(); }

 private:
  const std::shared_ptr<const TreeSnapshot> inner_;
  const std::function<void(size_t rays)> begin_;
  const std::function<void()> end_;
};

// A store whose trees call hooks before and after each query, whose progress can be made up, and whose directory can be
// slow.
class HookedStore final : public MeshStore {
 public:
  struct Hooks {
    std::function<void(size_t rays)> on_query = [](size_t) {};
    std::function<void()> on_query_end = [] {};
    std::function<void(BuildReport*)> on_watch = [](BuildReport*) {};
    std::function<void()> on_look_up = [] {};  // a mesh that is not known is looked for on the disk
  };

  HookedStore(std::unique_ptr<MeshStore> inner, Hooks hooks) : inner_(std::move(inner)), hooks_(std::move(hooks)) {}

  absl::StatusOr<std::unique_ptr<Upload>> StartUpload() override { return inner_->StartUpload(); }
  absl::StatusOr<MeshInfo> Get(absl::string_view mesh) const override {
    LookUp(mesh);
    return inner_->Get(mesh);
  }
  std::vector<MeshInfo> List(absl::string_view after_id, size_t limit) const override {
    return inner_->List(after_id, limit);
  }
  absl::StatusOr<std::string> Name(absl::string_view name, absl::string_view mesh) override {
    return inner_->Name(name, mesh);
  }
  absl::StatusOr<std::string> Delete(absl::string_view mesh) override { return inner_->Delete(mesh); }
  absl::StatusOr<MeshInfo> Rebuild(absl::string_view mesh, const Config& config) override {
    return inner_->Rebuild(mesh, config);
  }
  absl::StatusOr<std::string> ResolveKnown(absl::string_view mesh) const override { return inner_->ResolveKnown(mesh); }
  absl::StatusOr<std::string> Resolve(absl::string_view mesh) const override {
    LookUp(mesh);
    return inner_->Resolve(mesh);
  }
  void WithTree(absl::string_view mesh, bool final, std::function<void(absl::StatusOr<Answer>)> callback,
                std::function<bool()> cancelled) override {
    const auto on_tree = [this, callback](absl::StatusOr<Answer> answer) {
      if (answer.ok()) {
        auto hooked = std::make_shared<TreeSnapshot>(*answer->snapshot);
        hooked->tree = std::make_shared<HookedTree>(answer->snapshot, hooks_.on_query, hooks_.on_query_end);
        answer->snapshot = hooked;
      }
      callback(std::move(answer));
    };
    inner_->WithTree(mesh, final, on_tree, std::move(cancelled));
  }
  void ForgetCancelled() override { inner_->ForgetCancelled(); }
  void StopWaiting(const absl::Status& status) override { inner_->StopWaiting(status); }
  void NoteAnswer(const Answer& answer) override { inner_->NoteAnswer(answer); }
  absl::StatusOr<BuildReport> Watch(absl::string_view mesh, bool start) override {
    absl::StatusOr<BuildReport> report = inner_->Watch(mesh, start);
    if (report.ok()) hooks_.on_watch(&*report);
    return report;
  }
  absl::StatusOr<StoredStatistics> Statistics(absl::string_view mesh) const override {
    return inner_->Statistics(mesh);
  }
  StoreUsage Usage() const override { return inner_->Usage(); }

 private:
  void LookUp(absl::string_view mesh) const {
    if (!inner_->IsKnown(mesh)) hooks_.on_look_up();
  }

  const std::unique_ptr<MeshStore> inner_;
  const Hooks hooks_;
};

// Queries that begin, and end once they are let go on.
class HeldQueries {
 public:
  ~HeldQueries() { LetGo(); }

  // For HookedStore; may outlive this.
  HookedStore::Hooks hooks() const {
    HookedStore::Hooks hooks;
    hooks.on_query = [state = state_](size_t) {
      state->begun = true;
      while (!state->let_go) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    };
    return hooks;
  }
  // Whether one has begun.
  bool Await() const {
    return Eventually([this] { return state_->begun.load(); });
  }
  void LetGo() { state_->let_go = true; }

 private:
  struct State {
    std::atomic<bool> begun{false}, let_go{false};
  };
  const std::shared_ptr<State> state_ = std::make_shared<State>();
};

// A directory that does not answer for a time: whoever looks for a mesh that is not known waits.
class HeldLookUps {
 public:
  ~HeldLookUps() { LetGo(); }

  // For HookedStore; may outlive this.
  HookedStore::Hooks hooks() const {
    HookedStore::Hooks hooks;
    hooks.on_look_up = [state = state_] {
      ++state->waiting;
      while (!state->let_go) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    };
    return hooks;
  }
  // Whether so many wait.
  bool Await(int count) const {
    return Eventually([&] { return state_->waiting >= count; });
  }
  void LetGo() { state_->let_go = true; }

 private:
  struct State {
    std::atomic<int> waiting{0};
    std::atomic<bool> let_go{false};
  };
  const std::shared_ptr<State> state_ = std::make_shared<State>();
};

// An OBJ file of `count` unit squares one above the other at z = first, first + 1, ...: meshes.h' Squares.
inline std::string SquaresObj(int count, int first = 0) {
  std::string obj;
  for (int i = first; i < first + count; ++i) {
    absl::StrAppend(&obj, "v 0 0 ", i, "\nv 1 0 ", i, "\nv 1 1 ", i, "\nv 0 1 ", i, "\nf -4 -3 -2 -1\n");
  }
  return obj;
}

class RunningServer : public testing::Test {
 protected:
  RunningServer() {
    std::string pattern = testing::TempDir() + "/deltaray_service_XXXXXX";
    directory_ = mkdtemp(pattern.data());
    options_.listen = "127.0.0.1:0";
    options_.store.data_directory = directory_ + "/data";
    options_.store.build_threads = 2;
    options_.threads = 2;
  }
  ~RunningServer() override {
    server_.reset();
    std::error_code ignored;
    std::filesystem::remove_all(directory_, ignored);
  }

  // Starts the server by options_, over a hooked store.
  void Start(HookedStore::Hooks hooks = {}) {
    absl::StatusOr<std::unique_ptr<MeshStore>> store = MeshStore::Open(options_.store);
    ASSERT_TRUE(store.ok()) << store.status();
    absl::StatusOr<std::unique_ptr<Server>> server =
        Server::Start(options_, std::make_unique<HookedStore>(*std::move(store), std::move(hooks)));
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
    channel_ = Connect();
    meshes_ = v1::MeshService::NewStub(channel_);
    rays_ = v1::RayService::NewStub(channel_);
  }

  // A channel of its own, with a connection of its own.
  std::shared_ptr<grpc::Channel> Connect(grpc::ChannelArguments arguments = {}) {
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    arguments.SetMaxReceiveMessageSize(-1);
    return grpc::CreateCustomChannel(absl::StrCat("127.0.0.1:", server_->port()), grpc::InsecureChannelCredentials(),
                                     arguments);
  }

  // Uploads `bytes` in chunks of `chunk` bytes.
  grpc::Status Upload(const std::string& bytes, v1::UploadHeader header, v1::UploadMeshResponse* response,
                      size_t chunk = 1000) {
    grpc::ClientContext context;
    auto writer = meshes_->UploadMesh(&context, response);
    v1::UploadMeshRequest request;
    *request.mutable_header() = std::move(header);
    bool open = writer->Write(request);
    for (size_t i = 0; open && i < bytes.size(); i += chunk) {
      request.set_chunk(bytes.substr(i, chunk));
      open = writer->Write(request);
    }
    writer->WritesDone();
    return writer->Finish();
  }

  // Uploads squares, which must work, and returns the id.
  std::string UploadSquares(int count, int first = 0, const std::string& name = "") {
    v1::UploadHeader header;
    header.set_name(name);
    v1::UploadMeshResponse response;
    const grpc::Status status = Upload(SquaresObj(count, first), header, &response);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return response.mesh().id();
  }

  // A unary call with a request of any bytes.
  grpc::Status CallRaw(const std::string& method, const std::string& request, grpc::ByteBuffer* response) {
    grpc::Slice slice(request);
    const grpc::ByteBuffer bytes(&slice, 1);
    grpc::ClientContext context;
    return grpc::internal::BlockingUnaryCall<grpc::ByteBuffer, grpc::ByteBuffer>(
        channel_.get(), grpc::internal::RpcMethod(method.c_str(), grpc::internal::RpcMethod::NORMAL_RPC), &context,
        bytes, response);
  }

  std::string directory_;
  ServerOptions options_;
  std::unique_ptr<Server> server_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::MeshService::Stub> meshes_;
  std::unique_ptr<v1::RayService::Stub> rays_;
};

}  // namespace deltaray

#endif  // TESTS_UNIT_SERVICE_RUNNING_SERVER_H_
