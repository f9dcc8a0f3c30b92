#include "server/service/tls_certificates.h"

#include <cstdlib>
#include <fstream>
#include <iterator>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/unit/service/running_server.h"

namespace deltaray {
namespace {

using testing::HasSubstr;

// Over certificates that openssl makes once; see certificates.sh.
class TlsCertificatesTest : public RunningServer {
 protected:
  static void SetUpTestSuite() {
    std::string pattern = testing::TempDir() + "/deltaray_certificates_XXXXXX";
    certificates_ = mkdtemp(pattern.data());
    ASSERT_EQ(std::system(absl::StrCat("bash " DELTARAY_CERTIFICATES_SH " ", certificates_).c_str()), 0);
  }
  static void TearDownTestSuite() { std::filesystem::remove_all(certificates_); }

  static std::string Path(const std::string& file) { return certificates_ + "/" + file; }
  static std::string Read(const std::string& file) {
    std::ifstream stream(Path(file));
    return std::string(std::istreambuf_iterator<char>(stream), {});
  }

  TlsCertificatesTest() {
    options_.security.tls_cert = directory_ + "/cert";
    options_.security.tls_key = directory_ + "/key";
    Use("server");
  }

  // Copies a certificate and its key to where the server looks.
  void Use(const std::string& name) {
    std::filesystem::copy(Path(name + ".pem"), options_.security.tls_cert,
                          std::filesystem::copy_options::overwrite_existing);
    std::filesystem::copy(Path(name + ".key"), options_.security.tls_key,
                          std::filesystem::copy_options::overwrite_existing);
  }

  // Whether a client that trusts `authority`, and shows the certificate of `name`, can call.
  bool CanCall(const std::string& authority, const std::string& name = "") {
    grpc::SslCredentialsOptions options;
    options.pem_root_certs = Read(authority + ".pem");
    if (!name.empty()) {
      options.pem_private_key = Read(name + ".key");
      options.pem_cert_chain = Read(name + ".pem");
    }
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    const auto channel = grpc::CreateCustomChannel(absl::StrCat("127.0.0.1:", server_->port()),
                                                   grpc::SslCredentials(options), arguments);
    grpc::ClientContext context;
    v1::ListMeshesResponse response;
    return v1::MeshService::NewStub(channel)->ListMeshes(&context, {}, &response).ok();
  }

  std::string StartError() {
    const auto certificates = TlsCertificates::Start(options_.security);
    return std::string(certificates.status().message());
  }

  inline static std::string certificates_;
};

TEST_F(TlsCertificatesTest, ServesClientsThatTrustItsAuthority) {
  Start();
  EXPECT_TRUE(CanCall("ca"));
  EXPECT_FALSE(CanCall("other-ca"));
  v1::ListMeshesResponse response;
  grpc::ClientContext plaintext;
  EXPECT_FALSE(meshes_->ListMeshes(&plaintext, {}, &response).ok());
}

TEST_F(TlsCertificatesTest, MutualTlsAsksForACertificateOfTheRightAuthority) {
  options_.security.tls_client_ca = Path("ca.pem");
  Start();
  EXPECT_TRUE(CanCall("ca", "client"));
  EXPECT_FALSE(CanCall("ca"));
  EXPECT_FALSE(CanCall("ca", "stranger"));
}

TEST_F(TlsCertificatesTest, BadNewFilesLeaveTheOldOnesInUse) {
  Start();
  std::ofstream(options_.security.tls_cert) << "nonsense";
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));
  EXPECT_TRUE(CanCall("ca"));
  Use("server");
  std::filesystem::copy(Path("renewed.key"), options_.security.tls_key,
                        std::filesystem::copy_options::overwrite_existing);
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));
  EXPECT_TRUE(CanCall("ca"));
  std::filesystem::remove(options_.security.tls_key);
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));
  EXPECT_TRUE(CanCall("ca"));
}

TEST_F(TlsCertificatesTest, GoodNewFilesTakeEffect) {
  Start();
  EXPECT_TRUE(CanCall("ca"));
  Use("stranger");
  EXPECT_TRUE(Eventually([&] { return !CanCall("ca"); }));
  Use("renewed");
  EXPECT_TRUE(Eventually([&] { return CanCall("ca"); }));
}

TEST_F(TlsCertificatesTest, FilesOfNoUseAreRefusedByFlagAndFile) {
  EXPECT_EQ(StartError(), "");
  std::filesystem::copy(Path("renewed.key"), options_.security.tls_key,
                        std::filesystem::copy_options::overwrite_existing);
  EXPECT_THAT(StartError(), HasSubstr(absl::StrCat("--tls-key: ", options_.security.tls_key, ": is not the key of")));
  Use("short");
  EXPECT_THAT(StartError(), HasSubstr(absl::StrCat("--tls-cert: ", options_.security.tls_cert, ": is of no use")));
  Use("server");
  std::ofstream(options_.security.tls_cert, std::ios::app) << Read("ca.pem").substr(0, 300);
  EXPECT_THAT(StartError(), HasSubstr("certificate 2 is damaged"));
  Use("server");
  options_.security.tls_client_ca = Path("ca.key");
  EXPECT_THAT(StartError(), HasSubstr(absl::StrCat("--tls-client-ca: ", Path("ca.key"), ": holds no certificate")));
  options_.security.tls_client_ca = Path("ca.pem");
  options_.security.tls_key = directory_ + "/none";
  EXPECT_THAT(StartError(), HasSubstr("/none: No such file"));
}

}  // namespace
}  // namespace deltaray
