#include "server/service/authenticator.h"

#include <fstream>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/store/sha256.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

class AuthenticatorTest : public RunningServer {
 protected:
  AuthenticatorTest() {
    options_.security.token_file = directory_ + "/tokens";
    WriteTokens(absl::StrCat("read ", Sha256::Hex("reader"), "\nwrite ", Sha256::Hex("writer"), "\n"));
  }

  void WriteTokens(const std::string& text) { std::ofstream(options_.security.token_file) << text; }

  // Readies a context with the values of `authorization`.
  static std::unique_ptr<grpc::ClientContext> With(const std::vector<std::string>& authorizations) {
    auto context = std::make_unique<grpc::ClientContext>();
    for (const std::string& value : authorizations) context->AddMetadata("authorization", value);
    return context;
  }

  grpc::Status List(const std::vector<std::string>& authorizations) {
    v1::ListMeshesResponse response;
    return meshes_->ListMeshes(With(authorizations).get(), {}, &response);
  }

  // What each RPC ends with, by its name.
  std::map<std::string, grpc::Status> CallAll(const std::vector<std::string>& authorizations) {
    std::map<std::string, grpc::Status> ends;
    const auto unary = [&](const std::string& name, auto&& call) { ends[name] = call(With(authorizations).get()); };
    v1::GetMeshResponse mesh;
    unary("GetMesh", [&](auto* context) { return meshes_->GetMesh(context, {}, &mesh); });
    v1::ListMeshesResponse list;
    unary("ListMeshes", [&](auto* context) { return meshes_->ListMeshes(context, {}, &list); });
    v1::NameMeshResponse name;
    unary("NameMesh", [&](auto* context) { return meshes_->NameMesh(context, {}, &name); });
    v1::DeleteMeshResponse deleted;
    unary("DeleteMesh", [&](auto* context) { return meshes_->DeleteMesh(context, {}, &deleted); });
    v1::RebuildMeshResponse rebuilt;
    unary("RebuildMesh", [&](auto* context) { return meshes_->RebuildMesh(context, {}, &rebuilt); });
    v1::GetBuildStatsResponse stats;
    unary("GetBuildStats", [&](auto* context) { return meshes_->GetBuildStats(context, {}, &stats); });
    v1::CastRaysResponse cast;
    unary("CastRays", [&](auto* context) { return rays_->CastRays(context, {}, &cast); });
    v1::CompareAccuracyResponse accuracy;
    unary("CompareAccuracy", [&](auto* context) { return rays_->CompareAccuracy(context, {}, &accuracy); });
    unary("UploadMesh", [&](auto* context) {
      v1::UploadMeshResponse response;
      const auto writer = meshes_->UploadMesh(context, &response);
      writer->WritesDone();
      return writer->Finish();
    });
    unary("WatchBuild", [&](auto* context) { return meshes_->WatchBuild(context, {})->Finish(); });
    unary("StreamRays", [&](auto* context) {
      const auto stream = rays_->StreamRays(context);
      stream->WritesDone();
      return stream->Finish();
    });
    return ends;
  }
};

const std::set<std::string>& Changes() {
  static const auto& names = *new std::set<std::string>{"UploadMesh", "NameMesh", "DeleteMesh", "RebuildMesh"};
  return names;
}

TEST_F(AuthenticatorTest, NobodyGetsInWithoutATokenOfTheFile) {
  Start();
  for (const std::vector<std::string>& authorizations : {std::vector<std::string>{},
                                                         {""},
                                                         {"Bearer"},
                                                         {"Bearer "},
                                                         {"Bearer wrong"},
                                                         {"Basic reader"},
                                                         {"reader"},
                                                         {"Bearer reader", "Bearer writer"},
                                                         {absl::StrCat("Bearer ", Sha256::Hex("writer"))}}) {
    for (const auto& [name, status] : CallAll(authorizations)) {
      EXPECT_EQ(status.error_code(), StatusCode::UNAUTHENTICATED) << name;
    }
  }
  EXPECT_THAT(List({}).error_message(), HasSubstr("authorization: Bearer TOKEN"));
  EXPECT_THAT(List({"Bearer "}).error_message(), HasSubstr("of the form 'Bearer TOKEN'"));
  EXPECT_THAT(List({"Bearer wrong"}).error_message(), HasSubstr("not one that this server knows"));
}

TEST_F(AuthenticatorTest, ReadersMayAskAndNotChange) {
  Start();
  for (const auto& [name, status] : CallAll({"Bearer reader"})) {
    if (Changes().contains(name)) {
      EXPECT_EQ(status.error_code(), StatusCode::PERMISSION_DENIED) << name;
      EXPECT_THAT(status.error_message(), HasSubstr(name));
      EXPECT_THAT(status.error_message(), HasSubstr("'write'"));
    } else {
      EXPECT_NE(status.error_code(), StatusCode::PERMISSION_DENIED) << name;
      EXPECT_NE(status.error_code(), StatusCode::UNAUTHENTICATED) << name;
    }
  }
}

TEST_F(AuthenticatorTest, WritersMayDoAllAndTheSchemeIsOfAnyCase) {
  Start();
  for (const char* authorization : {"Bearer writer", "bearer writer"}) {
    for (const auto& [name, status] : CallAll({authorization})) {
      EXPECT_NE(status.error_code(), StatusCode::PERMISSION_DENIED) << name;
      EXPECT_NE(status.error_code(), StatusCode::UNAUTHENTICATED) << name;
    }
  }
}

TEST_F(AuthenticatorTest, HealthIsOpen) {
  Start();
  grpc::ByteBuffer response;
  EXPECT_TRUE(CallRaw("/grpc.health.v1.Health/Check", "", &response).ok());
}

TEST_F(AuthenticatorTest, AMethodThatThereIsNotGetsNobodyAnything) {
  Start();
  grpc::ByteBuffer response;
  EXPECT_EQ(CallRaw("/deltaray.v1.MeshService/Nothing", "", &response).error_code(), StatusCode::UNIMPLEMENTED);
}

TEST_F(AuthenticatorTest, NewTokensTakeEffectAndABadFileDoesNot) {
  Start();
  WriteTokens("nonsense");
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));
  EXPECT_TRUE(List({"Bearer reader"}).ok());
  EXPECT_EQ(List({}).error_code(), StatusCode::UNAUTHENTICATED);
  WriteTokens(absl::StrCat("read ", Sha256::Hex("other"), "\n"));
  EXPECT_TRUE(Eventually([&] { return List({"Bearer other"}).ok(); }));
  EXPECT_EQ(List({"Bearer reader"}).error_code(), StatusCode::UNAUTHENTICATED);
}

TEST_F(AuthenticatorTest, DoesNotStartWithoutItsFile) {
  EXPECT_THAT(std::string(Authenticator::Start(directory_ + "/none").status().message()),
              HasSubstr(absl::StrCat("--token-file: ", directory_, "/none: No such file")));
  WriteTokens("");
  EXPECT_THAT(std::string(Authenticator::Start(options_.security.token_file).status().message()),
              HasSubstr("holds no token"));
}

}  // namespace
}  // namespace deltaray
