#include "server/service/upload_call.h"

#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/meshes.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using grpc::StatusCode;
using testing::HasSubstr;

class UploadCallTest : public RunningServer {
 protected:
  size_t MeshCount() {
    grpc::ClientContext context;
    v1::ListMeshesResponse list;
    EXPECT_TRUE(meshes_->ListMeshes(&context, {}, &list).ok());
    return list.meshes_size();
  }

  // Expects an upload with this header to fail so.
  void ExpectRefused(const v1::UploadHeader& header, StatusCode code, const std::string& text) {
    v1::UploadMeshResponse response;
    const grpc::Status status = Upload(SquaresObj(1), header, &response);
    EXPECT_EQ(status.error_code(), code) << status.error_message();
    EXPECT_THAT(status.error_message(), HasSubstr(text));
    EXPECT_EQ(MeshCount(), 0u);
  }
};

TEST_F(UploadCallTest, UploadsRawArrays) {
  Start();
  v1::UploadHeader header;
  header.set_format(v1::MESH_FORMAT_RAW);
  header.mutable_raw_layout()->set_vertex_count(4);
  header.mutable_raw_layout()->set_triangle_count(4);
  header.mutable_raw_layout()->set_position_type(v1::SCALAR_TYPE_FLOAT64);
  const std::string tetrahedron =
      Bytes<double>({0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}) + Bytes<uint32_t>({0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3});
  v1::UploadMeshResponse response;
  const grpc::Status status = Upload(tetrahedron, header, &response, 11);
  ASSERT_TRUE(status.ok()) << status.error_message();
  EXPECT_EQ(response.mesh().triangle_count(), 4u);
}

TEST_F(UploadCallTest, RefusesBadHeadersByField) {
  options_.store.max_upload_bytes = 10'000;
  Start();
  v1::UploadHeader header;
  header.set_name(std::string(129, 'n'));
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.name: ");
  header = {};
  header.set_format(static_cast<v1::MeshFormat>(17));
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.format: 17");
  header = {};
  header.set_format(v1::MESH_FORMAT_RAW);
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.raw_layout: must be set for MESH_FORMAT_RAW");
  header.mutable_raw_layout()->set_position_type(static_cast<v1::ScalarType>(3));
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.raw_layout.position_type: 3");
  header = {};
  header.mutable_raw_layout();
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.raw_layout: must be unset");
  header = {};
  header.set_size_bytes(10'001);
  ExpectRefused(header, StatusCode::RESOURCE_EXHAUSTED, "header.size_bytes: 10001 is over the limit of 10000 bytes");
  header = {};
  header.set_size_bytes(1);
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "");
  header = {};
  header.set_sha256("short");
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.sha256: 5 bytes, neither 32 nor none");
  header = {};
  header.set_sha256(std::string(32, 'x'));
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "");
  header = {};
  header.mutable_build_options()->set_delta(5000);
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.build_options.delta");
  header = {};
  header.mutable_build_options()->set_preset(v1::BUILD_PRESET_AUTO);
  header.mutable_build_options()->set_delta(0);
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.build_options.delta is 0; it must be 1 to 4096");
  header = {};
  header.mutable_build_options()->set_alpha(std::nan(""));
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.build_options.alpha");
  header = {};
  header.mutable_build_options()->set_builder(v1::TREE_BUILDER_BVH);
  header.mutable_build_options()->set_lazy(true);
  ExpectRefused(header, StatusCode::INVALID_ARGUMENT, "header.build_options.lazy");
}

TEST_F(UploadCallTest, RefusesUploadsOverTheLimitInBytes) {
  options_.store.max_upload_bytes = 5'000;
  Start();
  v1::UploadMeshResponse response;
  const grpc::Status status = Upload(SquaresObj(1000), {}, &response);
  EXPECT_EQ(status.error_code(), StatusCode::RESOURCE_EXHAUSTED) << status.error_message();
  EXPECT_THAT(status.error_message(), HasSubstr("5000"));
  EXPECT_EQ(MeshCount(), 0u);
}

TEST_F(UploadCallTest, RefusesMalformedFilesAndLeavesNothing) {
  Start();
  v1::UploadHeader header;
  header.set_format(v1::MESH_FORMAT_OBJ);
  v1::UploadMeshResponse response;
  const grpc::Status status = Upload("v 0 0 0\nf 1 2 3\n", header, &response);
  EXPECT_EQ(status.error_code(), StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(status.error_message(), HasSubstr("line 2"));
  EXPECT_EQ(MeshCount(), 0u);
}

// A malformed message of a stream looks like the end of the stream to gRPC, which would store half a mesh.
TEST_F(UploadCallTest, RefusesMalformedMessagesOfAnUpload) {
  Start();
  for (const bool first : {true, false}) {
    grpc::ClientContext context;
    grpc::ByteBuffer response;
    std::unique_ptr<grpc::ClientWriter<grpc::ByteBuffer>> writer(
        grpc::internal::ClientWriterFactory<grpc::ByteBuffer>::Create(
            channel_.get(),
            grpc::internal::RpcMethod("/deltaray.v1.MeshService/UploadMesh",
                                      grpc::internal::RpcMethod::CLIENT_STREAMING),
            &context, &response));
    const auto write = [&writer](const std::string& bytes) {
      grpc::Slice slice(bytes);
      writer->Write(grpc::ByteBuffer(&slice, 1));
    };
    v1::UploadMeshRequest request;
    if (!first) {
      request.mutable_header();
      write(request.SerializeAsString());
      request.set_chunk(SquaresObj(1));
      write(request.SerializeAsString());
    }
    write("\x12\xff\xff");
    writer->WritesDone();
    const grpc::Status status = writer->Finish();
    EXPECT_EQ(status.error_code(), StatusCode::INVALID_ARGUMENT) << status.error_message();
    EXPECT_THAT(status.error_message(), HasSubstr(first ? "message 0: malformed" : "message 2: malformed"));
  }
  EXPECT_EQ(MeshCount(), 0u);
}

TEST_F(UploadCallTest, RefusesUploadsOutOfOrder) {
  Start();
  v1::UploadMeshResponse response;
  {
    grpc::ClientContext context;
    auto writer = meshes_->UploadMesh(&context, &response);
    v1::UploadMeshRequest request;
    request.set_chunk("v 0 0 0\n");
    writer->Write(request);
    EXPECT_EQ(writer->Finish().error_message(), "the first message of an upload must hold header");
  }
  {
    grpc::ClientContext context;
    auto writer = meshes_->UploadMesh(&context, &response);
    v1::UploadMeshRequest request;
    request.mutable_header();
    writer->Write(request);
    writer->Write(request);
    EXPECT_THAT(writer->Finish().error_message(), HasSubstr("message 1: all messages of an upload but the first"));
  }
  {
    grpc::ClientContext context;
    auto writer = meshes_->UploadMesh(&context, &response);
    writer->WritesDone();
    EXPECT_EQ(writer->Finish().error_code(), StatusCode::INVALID_ARGUMENT);
  }
  EXPECT_EQ(MeshCount(), 0u);
}

TEST_F(UploadCallTest, ACancelledUploadLeavesNothing) {
  Start();
  for (int i = 0; i < 20; ++i) {
    grpc::ClientContext context;
    v1::UploadMeshResponse response;
    auto writer = meshes_->UploadMesh(&context, &response);
    v1::UploadMeshRequest request;
    request.mutable_header();
    ASSERT_TRUE(writer->Write(request));
    // What has been sent is a whole mesh, so that taking the cancellation for the end would store it.
    request.set_chunk(SquaresObj(1, i));
    ASSERT_TRUE(writer->Write(request));
    if (i % 2 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    context.TryCancel();
    EXPECT_EQ(writer->Finish().error_code(), StatusCode::CANCELLED);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_EQ(MeshCount(), 0u);
}

}  // namespace
}  // namespace deltaray
