#include "server/service/mesh_handlers.h"

#include <atomic>
#include <set>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "openssl/sha.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::ElementsAre;
using testing::HasSubstr;

std::string Sha256(const std::string& bytes) {
  std::string digest(32, 0);
  SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(),
         reinterpret_cast<unsigned char*>(digest.data()));
  return digest;
}

class MeshHandlersTest : public RunningServer {
 protected:
  // The reports of a build up to its end.
  grpc::Status WatchAll(const std::string& mesh, std::vector<v1::WatchBuildResponse>* reports) {
    grpc::ClientContext context;
    v1::WatchBuildRequest request;
    request.set_mesh(mesh);
    auto reader = meshes_->WatchBuild(&context, request);
    v1::WatchBuildResponse report;
    while (reader->Read(&report)) reports->push_back(report);
    return reader->Finish();
  }
};

TEST_F(MeshHandlersTest, UploadsNamesAndTellsOfAMesh) {
  Start();
  const std::string obj = SquaresObj(3);
  v1::UploadHeader header;
  header.set_name("squares");
  header.set_size_bytes(obj.size());
  header.set_sha256(Sha256(obj));
  v1::UploadMeshResponse uploaded;
  ASSERT_TRUE(Upload(obj, header, &uploaded, 7).ok());
  EXPECT_TRUE(uploaded.created());
  EXPECT_EQ(uploaded.mesh().id().size(), 64u);

  grpc::ClientContext context;
  v1::GetMeshRequest request;
  request.set_mesh("squares");
  v1::GetMeshResponse got;
  ASSERT_TRUE(meshes_->GetMesh(&context, request, &got).ok());
  const v1::Mesh& mesh = got.mesh();
  EXPECT_EQ(mesh.id(), uploaded.mesh().id());
  EXPECT_THAT(mesh.names(), ElementsAre("squares"));
  EXPECT_EQ(mesh.vertex_count(), 12u);
  EXPECT_EQ(mesh.triangle_count(), 6u);
  EXPECT_EQ(mesh.face_count(), 3u);
  EXPECT_EQ(mesh.bounds().max().z(), 2);
  EXPECT_EQ(mesh.build_options().builder(), v1::TREE_BUILDER_HYBRID);
  EXPECT_EQ(mesh.build_options().delta(), 32u);
  EXPECT_GT(mesh.create_time().seconds(), 1'600'000'000);
  EXPECT_GT(mesh.stored_bytes(), 0u);

  v1::UploadMeshResponse again;
  ASSERT_TRUE(Upload(obj, {}, &again).ok());
  EXPECT_FALSE(again.created());
  EXPECT_EQ(again.mesh().id(), mesh.id());
}

TEST_F(MeshHandlersTest, MalformedUnaryRequestsAreInvalid) {
  Start();
  for (const char* method :
       {"MeshService/GetMesh", "MeshService/ListMeshes", "MeshService/NameMesh", "MeshService/DeleteMesh",
        "MeshService/RebuildMesh", "MeshService/GetBuildStats", "RayService/CastRays", "RayService/CompareAccuracy"}) {
    grpc::ByteBuffer response;
    const grpc::Status status = CallRaw(absl::StrCat("/deltaray.v1.", method), "\xff\xff\xff", &response);
    EXPECT_EQ(status.error_code(), StatusCode::INVALID_ARGUMENT) << method << ": " << status.error_message();
    EXPECT_THAT(status.error_message(), HasSubstr("malformed message"));
  }
}

TEST_F(MeshHandlersTest, NamesMoveAndGo) {
  Start();
  const std::string a = UploadSquares(1, 0, "mesh");
  const std::string b = UploadSquares(1, 1);
  const auto name = [this](const std::string& name, const std::string& mesh, std::string* previous) {
    grpc::ClientContext context;
    v1::NameMeshRequest request;
    request.set_name(name);
    request.set_mesh(mesh);
    v1::NameMeshResponse response;
    const grpc::Status status = meshes_->NameMesh(&context, request, &response);
    *previous = response.previous_id();
    return status;
  };
  std::string previous;
  ASSERT_TRUE(name("mesh", b, &previous).ok());
  EXPECT_EQ(previous, a);
  ASSERT_TRUE(name("new", b, &previous).ok());
  EXPECT_EQ(previous, "");
  ASSERT_TRUE(name("mesh", "", &previous).ok());
  EXPECT_EQ(name("mesh", "", &previous).error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(name("x", "nowhere", &previous).error_code(), StatusCode::NOT_FOUND);
  EXPECT_EQ(name(a, b, &previous).error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(name("", b, &previous).error_message(), HasSubstr("name: a mesh's name has 1 to 128 bytes, not 0"));
}

TEST_F(MeshHandlersTest, ListsPageByPage) {
  Start();
  std::set<std::string> ids;
  for (int i = 0; i < 5; ++i) ids.insert(UploadSquares(1, i));
  std::vector<std::string> listed;
  v1::ListMeshesRequest request;
  request.set_page_size(2);
  int pages = 0;
  do {
    grpc::ClientContext context;
    v1::ListMeshesResponse page;
    ASSERT_TRUE(meshes_->ListMeshes(&context, request, &page).ok());
    for (const v1::Mesh& mesh : page.meshes()) listed.push_back(mesh.id());
    request.set_page_token(page.next_page_token());
    ++pages;
  } while (!request.page_token().empty());
  EXPECT_EQ(pages, 3);
  EXPECT_EQ(listed, std::vector<std::string>(ids.begin(), ids.end()));

  request.set_page_token("page2");
  grpc::ClientContext context;
  v1::ListMeshesResponse page;
  EXPECT_THAT(meshes_->ListMeshes(&context, request, &page).error_message(), HasSubstr("page_token"));
}

TEST_F(MeshHandlersTest, PagesKeepToTheLimitOnMessages) {
  options_.batch.max_message_bytes = 1 << 16;
  Start();
  // Two meshes with some 25,000 bytes of warnings each fit on a page, three do not.
  std::set<std::string> ids;
  for (int i = 0; i < 3; ++i) {
    std::string obj = absl::StrCat("v 0 0 ", i, "\nv 1 0 0\nv 0 1 0\n");
    for (int k = 0; k < 99; ++k) obj += "g " + std::string(40, '\xFF') + "\nf 1 2 3\n";
    v1::UploadMeshResponse response;
    ASSERT_TRUE(Upload(obj, {}, &response).ok());
    ids.insert(response.mesh().id());
  }
  std::set<std::string> listed;
  v1::ListMeshesRequest request;
  int pages = 0;
  do {
    grpc::ClientContext context;
    v1::ListMeshesResponse page;
    ASSERT_TRUE(meshes_->ListMeshes(&context, request, &page).ok());
    EXPECT_LE(page.ByteSizeLong(), options_.batch.max_message_bytes);
    for (const v1::Mesh& mesh : page.meshes()) listed.insert(mesh.id());
    request.set_page_token(page.next_page_token());
    ++pages;
  } while (!request.page_token().empty() && pages < 10);
  EXPECT_EQ(pages, 2);
  EXPECT_EQ(listed, ids);
}

// An OBJ file whose groups have names of some 200 bytes each.
std::string GroupsObj(int count) {
  std::string obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  for (int i = 0; i < count; ++i) absl::StrAppend(&obj, "g ", i, std::string(200, 'x'), "\nf 1 2 3\n");
  return obj;
}

// The server was started with a lower limit since the mesh was stored.
TEST_F(MeshHandlersTest, MeshesThatFitNoReplySayWhy) {
  options_.batch.max_message_bytes = 1 << 16;
  Start();
  v1::UploadMeshResponse uploaded;
  v1::UploadHeader header;
  header.set_name("groups");
  const grpc::Status upload = Upload(GroupsObj(400), header, &uploaded);
  grpc::ClientContext context;
  v1::GetMeshRequest request;
  request.set_mesh("groups");
  v1::GetMeshResponse response;
  const grpc::Status get = meshes_->GetMesh(&context, request, &response);
  for (const grpc::Status& status : {upload, get}) {
    EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
    EXPECT_THAT(status.error_message(), HasSubstr("the reply of "));
    EXPECT_THAT(status.error_message(), HasSubstr("limit of 65536 bytes"));
  }
  EXPECT_THAT(upload.error_message(), HasSubstr("is stored"));
}

TEST_F(MeshHandlersTest, GroupsThatNoReplyCouldHoldAreRefused) {
  options_.batch.max_message_bytes = 1 << 16;
  absl::StatusOr<std::unique_ptr<Server>> server = Server::Start(options_);
  ASSERT_TRUE(server.ok()) << server.status();
  server_ = *std::move(server);
  meshes_ = v1::MeshService::NewStub(Connect());
  v1::UploadMeshResponse response;
  const grpc::Status status = Upload(GroupsObj(100), {}, &response);
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(status.error_message(), HasSubstr("16384 (--max-group-bytes)"));
}

TEST_F(MeshHandlersTest, UnknownMeshesAreNotFound) {
  Start();
  const std::string id(64, 'a');
  grpc::ClientContext contexts[4];
  v1::GetMeshRequest get;
  get.set_mesh(id);
  v1::GetMeshResponse got;
  EXPECT_EQ(meshes_->GetMesh(&contexts[0], get, &got).error_code(), StatusCode::NOT_FOUND);
  v1::DeleteMeshRequest remove;
  remove.set_mesh("nobody");
  v1::DeleteMeshResponse removed;
  EXPECT_EQ(meshes_->DeleteMesh(&contexts[1], remove, &removed).error_code(), StatusCode::NOT_FOUND);
  v1::RebuildMeshRequest rebuild;
  v1::RebuildMeshResponse rebuilt;
  EXPECT_EQ(meshes_->RebuildMesh(&contexts[2], rebuild, &rebuilt).error_code(), StatusCode::NOT_FOUND);
  v1::GetBuildStatsRequest stats;
  v1::GetBuildStatsResponse got_stats;
  EXPECT_EQ(meshes_->GetBuildStats(&contexts[3], stats, &got_stats).error_code(), StatusCode::NOT_FOUND);
  std::vector<v1::WatchBuildResponse> reports;
  EXPECT_EQ(WatchAll(id, &reports).error_code(), StatusCode::NOT_FOUND);
}

TEST_F(MeshHandlersTest, WatchesABuildToItsEndAndTellsItsStatistics) {
  Start();
  const std::string id = UploadSquares(200, 0, "squares");
  std::vector<v1::WatchBuildResponse> reports;
  ASSERT_TRUE(WatchAll("squares", &reports).ok());
  ASSERT_FALSE(reports.empty());
  EXPECT_EQ(reports.back().id(), id);
  EXPECT_EQ(reports.back().progress().state(), v1::MESH_STATE_READY);
  EXPECT_EQ(reports.back().progress().phase(), v1::BUILD_PHASE_DONE);
  EXPECT_EQ(reports.back().progress().triangles(), 400u);

  grpc::ClientContext context;
  v1::GetBuildStatsRequest request;
  request.set_mesh("squares");
  v1::GetBuildStatsResponse response;
  ASSERT_TRUE(meshes_->GetBuildStats(&context, request, &response).ok());
  EXPECT_EQ(response.id(), id);
  EXPECT_EQ(response.stats().triangles(), 400u);
  EXPECT_EQ(response.stats().build_number(), reports.back().progress().build_number());
  EXPECT_GE(response.stats().references(), 400u);
  EXPECT_GT(response.stats().nodes(), 0u);
  EXPECT_GT(response.stats().mesh_bytes(), 0u);
}

TEST_F(MeshHandlersTest, TellsWhatAutoChose) {
  Start();
  v1::UploadHeader header;
  header.mutable_build_options()->set_preset(v1::BUILD_PRESET_AUTO);
  v1::UploadMeshResponse uploaded;
  ASSERT_TRUE(Upload(SquaresObj(100), header, &uploaded).ok());
  EXPECT_EQ(uploaded.mesh().build_options().preset(), v1::BUILD_PRESET_AUTO);
  EXPECT_FALSE(uploaded.mesh().build_options().has_delta());
  std::vector<v1::WatchBuildResponse> reports;
  ASSERT_TRUE(WatchAll(uploaded.mesh().id(), &reports).ok());

  grpc::ClientContext context;
  v1::GetBuildStatsRequest request;
  request.set_mesh(uploaded.mesh().id());
  v1::GetBuildStatsResponse response;
  ASSERT_TRUE(meshes_->GetBuildStats(&context, request, &response).ok());
  EXPECT_EQ(response.stats().options().preset(), v1::BUILD_PRESET_AUTO);
  EXPECT_EQ(response.stats().options().delta(), 32u);
  EXPECT_EQ(response.stats().choices_size(), 3);
}

TEST_F(MeshHandlersTest, RebuildsWithOtherOptions) {
  Start();
  UploadSquares(50, 0, "squares");
  grpc::ClientContext contexts[5];
  v1::RebuildMeshRequest request;
  request.set_mesh("squares");
  request.mutable_build_options()->set_builder(v1::TREE_BUILDER_BVH);
  v1::RebuildMeshResponse response;
  ASSERT_TRUE(meshes_->RebuildMesh(&contexts[0], request, &response).ok());
  EXPECT_EQ(response.mesh().build_options().builder(), v1::TREE_BUILDER_BVH);
  std::vector<v1::WatchBuildResponse> reports;
  ASSERT_TRUE(WatchAll("squares", &reports).ok());
  EXPECT_EQ(reports.back().progress().state(), v1::MESH_STATE_READY);

  v1::GetBuildStatsRequest stats;
  stats.set_mesh("squares");
  v1::GetBuildStatsResponse got;
  ASSERT_TRUE(meshes_->GetBuildStats(&contexts[1], stats, &got).ok());
  EXPECT_EQ(got.stats().options().builder(), v1::TREE_BUILDER_BVH);

  // Without options as before.
  request.clear_build_options();
  ASSERT_TRUE(meshes_->RebuildMesh(&contexts[2], request, &response).ok());
  EXPECT_EQ(response.mesh().build_options().builder(), v1::TREE_BUILDER_BVH);
  // With some, the others take their defaults.
  request.mutable_build_options()->set_delta(7);
  ASSERT_TRUE(meshes_->RebuildMesh(&contexts[3], request, &response).ok());
  EXPECT_EQ(response.mesh().build_options().builder(), v1::TREE_BUILDER_HYBRID);

  request.mutable_build_options()->set_traversal_cost(-1);
  EXPECT_THAT(meshes_->RebuildMesh(&contexts[4], request, &response).error_message(),
              HasSubstr("build_options.traversal_cost"));
}

TEST_F(MeshHandlersTest, WatchReportsAtMostTenTimesASecond) {
  std::atomic<uint64_t> looks{0};
  HookedStore::Hooks hooks;
  // A build that goes on at every look, and ends at the seventh.
  hooks.on_watch = [&looks](BuildReport* report) {
    report->progress.delta_leaves_built = ++looks;
    report->state = looks < 7 ? MeshState::kBuilding : MeshState::kReady;
  };
  Start(hooks);
  UploadSquares(1, 0, "squares");
  const auto start = std::chrono::steady_clock::now();
  std::vector<v1::WatchBuildResponse> reports;
  ASSERT_TRUE(WatchAll("squares", &reports).ok());
  EXPECT_LE(reports.size(), 7u);  // less where one is still on its way at the next look
  EXPECT_GE(reports.size(), 4u);
  EXPECT_EQ(reports.back().progress().state(), v1::MESH_STATE_READY);
  EXPECT_GE(std::chrono::steady_clock::now() - start, std::chrono::milliseconds(590));
}

TEST_F(MeshHandlersTest, WatchEndsWhenTheTreeHasMadeRoom) {
  std::atomic<int> looks{0};
  HookedStore::Hooks hooks;
  hooks.on_watch = [&looks](BuildReport* report) {
    report->state = ++looks < 3 ? MeshState::kBuilding : MeshState::kStored;
  };
  Start(hooks);
  UploadSquares(1, 0, "squares");
  std::vector<v1::WatchBuildResponse> reports;
  ASSERT_TRUE(WatchAll("squares", &reports).ok());
  EXPECT_EQ(reports.back().progress().state(), v1::MESH_STATE_STORED);
}

TEST_F(MeshHandlersTest, RequestsOfManyFieldsAreRefusedUnread) {
  Start();
  UploadSquares(1, 0, "squares");
  v1::GetMeshRequest get;
  get.set_mesh("squares");
  grpc::ByteBuffer response;
  const std::string few(1000, '\x7b'), many(70'000, '\x7b');
  EXPECT_EQ(CallRaw("/deltaray.v1.MeshService/GetMesh", get.SerializeAsString() + few, &response).error_code(),
            StatusCode::INVALID_ARGUMENT);
  const grpc::Status status = CallRaw("/deltaray.v1.MeshService/GetMesh", get.SerializeAsString() + many, &response);
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_THAT(status.error_message(), HasSubstr("65536"));
  // An upload's chunk is not counted.
  v1::UploadMeshResponse uploaded;
  const std::string obj = SquaresObj(3000);
  ASSERT_TRUE(Upload(obj, {}, &uploaded, obj.size()).ok());
  v1::UploadHeader header;
  header.set_name(std::string(70'000, 'n'));
  EXPECT_EQ(Upload(obj, header, &uploaded).error_code(), StatusCode::RESOURCE_EXHAUSTED);
}

TEST_F(MeshHandlersTest, WatchEndsWhenTheMeshIsDeletedOrTheClientGoes) {
  HookedStore::Hooks hooks;
  hooks.on_watch = [](BuildReport* report) { report->state = MeshState::kBuilding; };
  Start(hooks);
  UploadSquares(1, 0, "squares");
  v1::WatchBuildRequest request;
  request.set_mesh("squares");
  v1::WatchBuildResponse report;
  {
    grpc::ClientContext context;
    auto reader = meshes_->WatchBuild(&context, request);
    ASSERT_TRUE(reader->Read(&report));
    EXPECT_EQ(report.progress().state(), v1::MESH_STATE_BUILDING);
    context.TryCancel();
    EXPECT_EQ(reader->Finish().error_code(), StatusCode::CANCELLED);
  }
  grpc::ClientContext context;
  auto reader = meshes_->WatchBuild(&context, request);
  ASSERT_TRUE(reader->Read(&report));
  grpc::ClientContext delete_context;
  v1::DeleteMeshRequest remove;
  remove.set_mesh("squares");
  v1::DeleteMeshResponse removed;
  ASSERT_TRUE(meshes_->DeleteMesh(&delete_context, remove, &removed).ok());
  EXPECT_EQ(removed.id(), report.id());
  while (reader->Read(&report)) {
  }
  EXPECT_EQ(reader->Finish().error_code(), StatusCode::NOT_FOUND);
}

}  // namespace
}  // namespace deltaray
