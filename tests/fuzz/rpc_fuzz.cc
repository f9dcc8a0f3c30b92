// The entry point of libFuzzer for the RPCs: whatever a client sends and however it ends, each call gets a code that
// is documented, and the server goes on to answer.

#include <openssl/crypto.h>
#include <stdlib.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "deltaray/v1/mesh_service.grpc.pb.h"
#include "deltaray/v1/ray_service.grpc.pb.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/support/sync_stream.h"
#include "server/service/server.h"
#include "spdlog/spdlog.h"
#include "tests/fuzz/byte_reader.h"
#include "tests/fuzz/check.h"

namespace deltaray {
namespace {

constexpr char kMeshService[] = "/deltaray.v1.MeshService/";
constexpr char kRayService[] = "/deltaray.v1.RayService/";
constexpr struct {
  const char* service;
  const char* name;
} kMethods[] = {{kMeshService, "UploadMesh"}, {kMeshService, "GetMesh"},       {kMeshService, "ListMeshes"},
                {kMeshService, "NameMesh"},   {kMeshService, "DeleteMesh"},    {kMeshService, "RebuildMesh"},
                {kMeshService, "WatchBuild"}, {kMeshService, "GetBuildStats"}, {kRayService, "CastRays"},
                {kRayService, "StreamRays"},  {kRayService, "CompareAccuracy"}};
constexpr char kTetrahedron[] = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
// No call of this fuzzer takes so long by far, save where it hangs.
constexpr std::chrono::seconds kCallTimeout{10};

// A server of small limits in this process, until the process ends.
class FuzzedServer {
 public:
  FuzzedServer() {
    spdlog::set_level(spdlog::level::off);
    std::string pattern = (std::filesystem::temp_directory_path() / "deltaray_rpc_fuzz_XXXXXX").string();
    directory_ = mkdtemp(pattern.data());
    ServerOptions options;
    options.listen = absl::StrCat("unix:", directory_, "/socket");
    options.store.data_directory = absl::StrCat(directory_, "/data");
    options.store.build_threads = 1;
    options.store.max_upload_bytes = 4096;
    options.store.mesh_limits.max_triangles = 500;
    options.threads = 1;
    options.batch = {.max_rays = 100, .max_message_bytes = 1 << 16};
    absl::StatusOr<std::unique_ptr<Server>> server = Server::Start(options);
    if (!server.ok()) FailFuzz(server.status().ToString());
    server_ = *std::move(server);
    channel_ = grpc::CreateChannel(options.listen, grpc::InsecureChannelCredentials());
    // Not in a thread of the server, with which what this allocates would be lost.
    OPENSSL_init_crypto(OPENSSL_INIT_LOAD_CONFIG, nullptr);
    atexit([] { Get().End(); });
  }

  static FuzzedServer& Get() {
    static auto* const server = new FuzzedServer;  // ended before what its threads use, the log above all
    return *server;
  }
  const std::shared_ptr<grpc::Channel>& channel() const { return channel_; }

 private:
  void End() {
    channel_.reset();
    server_.reset();
    std::filesystem::remove_all(directory_);
  }

  std::string directory_;
  std::unique_ptr<Server> server_;
  std::shared_ptr<grpc::Channel> channel_;
};

// Names that meet, and some that may not be one.
std::string MakeName(ByteReader& reader) {
  switch (reader.Below(8)) {
    case 0:
      return "";
    case 1:
      return "../a";
    case 2:
      return std::string(64, 'a');
    case 3:
      return std::string(reader.Byte(), static_cast<char>(reader.Byte()));
    default:
      return reader.Below(2) == 0 ? "a" : "b";
  }
}

v1::RayQuery MakeQuery(ByteReader& reader) {
  v1::RayQuery query;
  query.set_kind(static_cast<v1::QueryKind>(reader.Below(6)));
  query.set_layout(static_cast<v1::RayLayout>(reader.Below(6)));
  query.set_accuracy(static_cast<v1::AccuracyLevel>(reader.Below(5)));
  query.set_wait(static_cast<v1::BuildWait>(reader.Below(4)));
  return query;
}

v1::RayBatch MakeBatch(ByteReader& reader) {
  constexpr float kRay[] = {0.25F, 0.25F, 5, 0, 0, -1};
  v1::RayBatch batch;
  for (uint32_t i = reader.Below(120); i > 0; --i) {
    batch.mutable_rays()->append(reinterpret_cast<const char*>(kRay), sizeof(kRay));
  }
  if (reader.Below(8) == 0) batch.mutable_rays()->push_back(0);
  return batch;
}

v1::BuildOptions MakeBuildOptions(ByteReader& reader) {
  v1::BuildOptions options;
  options.set_preset(static_cast<v1::BuildPreset>(reader.Below(6)));
  options.set_builder(static_cast<v1::TreeBuilder>(reader.Below(7)));
  if (reader.Below(2) == 1) options.set_delta(reader.Below(4) == 0 ? reader.Word() : reader.Byte());
  if (reader.Below(4) == 1) options.set_alpha(reader.Float());
  if (reader.Below(2) == 1) options.set_lazy(true);
  return options;
}

// A message of the form that this method takes as its `number`th.
std::string MakeMessage(const std::string& method, size_t number, ByteReader& reader) {
  if (method == "UploadMesh") {
    v1::UploadMeshRequest upload;
    if (number == 0) {
      v1::UploadHeader& header = *upload.mutable_header();
      header.set_name(MakeName(reader));
      header.set_format(static_cast<v1::MeshFormat>(reader.Below(7)));
      if (reader.Below(4) == 0) header.set_size_bytes(reader.Word());
      if (reader.Below(8) == 0) header.set_sha256(std::string(reader.Below(40), 'x'));
      if (reader.Below(2) == 0) *header.mutable_build_options() = MakeBuildOptions(reader);
    } else if (reader.Below(2) == 0) {
      upload.set_chunk(kTetrahedron);
    } else {
      for (uint32_t i = reader.Byte(); i > 0; --i) upload.mutable_chunk()->push_back(static_cast<char>(reader.Byte()));
    }
    return upload.SerializeAsString();
  }
  if (method == "ListMeshes") {
    v1::ListMeshesRequest list;
    list.set_page_size(reader.Below(3));
    list.set_page_token(reader.Below(2) == 0 ? "" : MakeName(reader));
    return list.SerializeAsString();
  }
  if (method == "NameMesh") {
    v1::NameMeshRequest name;
    name.set_name(MakeName(reader));
    name.set_mesh(MakeName(reader));
    return name.SerializeAsString();
  }
  if (method == "RebuildMesh") {
    v1::RebuildMeshRequest rebuild;
    rebuild.set_mesh(MakeName(reader));
    *rebuild.mutable_build_options() = MakeBuildOptions(reader);
    return rebuild.SerializeAsString();
  }
  if (method == "CastRays") {
    v1::CastRaysRequest cast;
    cast.set_mesh(MakeName(reader));
    *cast.mutable_query() = MakeQuery(reader);
    *cast.mutable_rays() = MakeBatch(reader);
    return cast.SerializeAsString();
  }
  if (method == "StreamRays") {
    v1::StreamRaysRequest stream;
    if (number == 0) {
      stream.mutable_start()->set_mesh(MakeName(reader));
      *stream.mutable_start()->mutable_query() = MakeQuery(reader);
    } else {
      *stream.mutable_rays() = MakeBatch(reader);
    }
    return stream.SerializeAsString();
  }
  if (method == "CompareAccuracy") {
    v1::CompareAccuracyRequest compare;
    compare.set_mesh(MakeName(reader));
    compare.mutable_query()->set_kind(static_cast<v1::QueryKind>(reader.Below(6)));
    *compare.mutable_rays() = MakeBatch(reader);
    compare.set_rounds(reader.Below(40));
    return compare.SerializeAsString();
  }
  v1::GetMeshRequest get;  // as all others: field 1 is the mesh
  get.set_mesh(MakeName(reader));
  return get.SerializeAsString();
}

// One call: any method, any number of messages right or wrong, ended in any way.
void Call(ByteReader& reader) {
  const auto& method = reader.OneOf(kMethods);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + kCallTimeout);
  // All methods as streams, so that a unary one can get no message, or several.
  const std::string path = absl::StrCat(method.service, method.name);
  const grpc::internal::RpcMethod rpc(path.c_str(), grpc::internal::RpcMethod::BIDI_STREAMING);
  const std::unique_ptr<grpc::ClientReaderWriter<grpc::ByteBuffer, grpc::ByteBuffer>> stream(
      grpc::internal::ClientReaderWriterFactory<grpc::ByteBuffer, grpc::ByteBuffer>::Create(
          FuzzedServer::Get().channel().get(), rpc, &context));
  const uint32_t messages = reader.Below(6);
  for (uint32_t i = 0; i < messages; ++i) {
    std::string message;
    if (reader.Below(4) == 0) {
      for (uint32_t j = reader.Byte(); j > 0; --j) message.push_back(static_cast<char>(reader.Byte()));
    } else {
      message = MakeMessage(method.name, i, reader);
    }
    const grpc::Slice slice(message);
    if (!stream->Write(grpc::ByteBuffer(&slice, 1))) break;
  }
  const uint32_t end = reader.Below(8);
  if (end == 0) context.TryCancel();
  stream->WritesDone();
  if (end == 1) context.TryCancel();
  grpc::ByteBuffer reply;
  while (stream->Read(&reply)) {
  }
  const grpc::Status status = stream->Finish();
  if (status.ok() || (end <= 1 && status.error_code() == grpc::StatusCode::CANCELLED)) return;
  using absl::StatusCode;
  // UNIMPLEMENTED and INTERNAL come from gRPC's own library where a unary call has not one message.
  if (messages != 1 &&
      (status.error_code() == grpc::StatusCode::UNIMPLEMENTED || status.error_code() == grpc::StatusCode::INTERNAL)) {
    return;
  }
  CheckRefusal(absl::Status(static_cast<StatusCode>(status.error_code()), status.error_message()),
               {StatusCode::kInvalidArgument, StatusCode::kNotFound, StatusCode::kResourceExhausted,
                StatusCode::kFailedPrecondition, StatusCode::kDataLoss});
}

// A server that stands answers this, whatever came before.
void CheckStands() {
  const auto stub = v1::MeshService::NewStub(FuzzedServer::Get().channel());
  v1::ListMeshesResponse meshes;
  {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + kCallTimeout);
    const grpc::Status status = stub->ListMeshes(&context, {}, &meshes);
    if (!status.ok()) FailFuzz(absl::StrCat("the server does not answer any more: ", status.error_message()));
  }
  // So that no input sees what others left.
  for (const v1::Mesh& mesh : meshes.meshes()) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + kCallTimeout);
    v1::DeleteMeshRequest request;
    request.set_mesh(mesh.id());
    v1::DeleteMeshResponse deleted;
    const grpc::Status status = stub->DeleteMesh(&context, request, &deleted);
    Check(status.ok() || status.error_code() == grpc::StatusCode::NOT_FOUND, "DeleteMesh: " + status.error_message());
  }
}

}  // namespace
}  // namespace deltaray

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  deltaray::ByteReader reader({data, size});
  constexpr int kMostCalls = 8;
  for (int calls = 0; calls == 0 || (!reader.AtEnd() && calls < kMostCalls); ++calls) deltaray::Call(reader);
  deltaray::CheckStands();
  return 0;
}
