#include "client/tls.h"

#include <arpa/inet.h>
#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509_vfy.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "client/exit_code.h"

namespace deltaray {
namespace {

constexpr int kTimeoutSeconds = 3;

using Bio = std::unique_ptr<BIO, decltype(&BIO_free_all)>;

// Takes the reason of the last failure out of OpenSSL's queue.
std::string OpenSslReason() {
  const char* reason = ERR_reason_error_string(ERR_peek_last_error());
  ERR_clear_error();
  return reason == nullptr ? "unknown reason" : reason;
}

absl::Status FileError(const char* flag, const std::string& path, absl::string_view what) {
  return LocalError(absl::StrCat(flag, ": ", path, ": ", what));
}

absl::Status ReadWhole(const char* flag, const std::string& path, std::string* bytes) {
  // A stream opens it, and throws when it is read.
  if (std::error_code ignored; std::filesystem::is_directory(path, ignored)) {
    return FileError(flag, path, std::strerror(EISDIR));
  }
  std::ifstream file(path, std::ios::binary);
  if (file) bytes->assign(std::istreambuf_iterator<char>(file), {});
  return file ? absl::OkStatus() : FileError(flag, path, std::strerror(errno));
}

// Without this OpenSSL would ask for it at the terminal.
int NoPassphrase(char*, int, int, void*) { return 0; }

std::shared_ptr<SSL_CTX> NewContext() {
  std::shared_ptr<SSL_CTX> context(SSL_CTX_new(TLS_client_method()), SSL_CTX_free);
  SSL_CTX_set_min_proto_version(context.get(), TLS1_2_VERSION);
  SSL_CTX_set_default_passwd_cb(context.get(), NoPassphrase);
  // A length, and the name of HTTP/2.
  static constexpr unsigned char kAlpn[] = {2, 'h', '2'};
  SSL_CTX_set_alpn_protos(context.get(), kAlpn, sizeof(kAlpn));
  return context;
}

// host:port as gRPC's resolver takes it.
std::string HostPort(const std::string& server) {
  absl::string_view address = server;
  absl::ConsumePrefix(&address, "dns:");
  while (absl::ConsumePrefix(&address, "/")) {
  }
  return std::string(address);
}

// A TCP connection to `server` under TLS, before the handshake; nullptr where nobody listens.
Bio Connect(const std::string& server, SSL_CTX* context, SSL** ssl) {
  if (absl::StartsWith(server, "unix:")) return Bio(nullptr, BIO_free_all);
  Bio tcp(BIO_new_connect(HostPort(server).c_str()), BIO_free_all);
  if (tcp == nullptr) return tcp;
  // BIO_do_connect_retry would try again for all that time where nobody listens.
  const time_t deadline = time(nullptr) + kTimeoutSeconds;
  BIO_set_nbio(tcp.get(), 1);
  while (BIO_do_connect(tcp.get()) != 1) {
    if (BIO_should_retry(tcp.get()) && BIO_wait(tcp.get(), deadline, /*nap_milliseconds=*/10) == 1) continue;
    ERR_clear_error();
    return Bio(nullptr, BIO_free_all);
  }
  int fd = -1;
  BIO_get_fd(tcp.get(), &fd);
  BIO_socket_nbio(fd, 0);
  const timeval timeout = {.tv_sec = kTimeoutSeconds, .tv_usec = 0};
  setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof(timeout));
  Bio tls(BIO_new_ssl(context, /*client=*/1), BIO_free_all);
  BIO_get_ssl(tls.get(), ssl);
  BIO_push(tls.get(), tcp.release());
  return tls;
}

// Has the handshake check that the certificate is for the host of `server`.
std::string ExpectHost(const std::string& server, SSL* ssl) {
  std::string host = HostPort(server);
  host.resize(host.rfind(':') == std::string::npos ? host.size() : host.rfind(':'));
  if (absl::StartsWith(host, "[") && absl::EndsWith(host, "]")) host = host.substr(1, host.size() - 2);
  in6_addr ignored;
  if (inet_pton(AF_INET, host.c_str(), &ignored) == 1 || inet_pton(AF_INET6, host.c_str(), &ignored) == 1) {
    X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(ssl), host.c_str());
  } else {
    SSL_set_tlsext_host_name(ssl, host.c_str());
    SSL_set1_host(ssl, host.c_str());
  }
  return host;
}

std::string UntrustedText(long error, const std::string& host, bool has_ca_file) {
  const std::string text = X509_verify_cert_error_string(error);
  switch (error) {
    case X509_V_ERR_HOSTNAME_MISMATCH:
    case X509_V_ERR_IP_ADDRESS_MISMATCH:
      return absl::StrCat("the server's certificate is not for ", host, " (", text, ")");
    case X509_V_ERR_CERT_HAS_EXPIRED:
    case X509_V_ERR_CERT_NOT_YET_VALID:
      return absl::StrCat("the server's certificate is not valid now (", text, ")");
    default:
      return absl::StrCat("the server's certificate is of no authority ",
                          has_ca_file ? "in --ca" : "that this system knows; see --ca", " (", text, ")");
  }
}

// Notes that the server asks for a certificate; see SSL_set_cert_cb.
int NoteAsked(SSL*, void* asked) {
  *static_cast<bool*>(asked) = true;
  return 1;
}

// Why the handshake failed, or what came after it. `asked`: the server asked for a certificate; gRPC's servers close
// the connection without a word where they do not like the answer.
std::string FailureText(SSL* ssl, bool asked) {
  const unsigned long error = ERR_peek_last_error();
  const bool plaintext = ERR_GET_LIB(error) == ERR_LIB_SSL && ERR_GET_REASON(error) == SSL_R_WRONG_VERSION_NUMBER;
  const std::string reason = OpenSslReason();
  if (plaintext) return "a server is there, but it does not speak TLS";
  if (!asked) return absl::StrCat("no TLS connection came about (", reason, ")");
  return SSL_get_certificate(ssl) == nullptr ? "the server wants a certificate from its clients: --cert and --key"
                                             : "the server does not accept the certificate of --cert";
}

}  // namespace

absl::StatusOr<Tls> Tls::Read(const SecurityFlags& flags) {
  if (flags.cert_file.empty() != flags.key_file.empty()) {
    return UsageError(flags.cert_file.empty() ? "--key: --cert is missing" : "--cert: --key is missing");
  }
  Tls tls;
  tls.context_ = NewContext();
  SSL_CTX* const context = tls.context_.get();
  SSL_CTX_set_verify(context, SSL_VERIFY_PEER, nullptr);
  ERR_clear_error();
  if (flags.ca_file.empty()) {
    SSL_CTX_set_default_verify_paths(context);
  } else {
    absl::Status status = ReadWhole("--ca", flags.ca_file, &tls.options_.pem_root_certs);
    if (!status.ok()) return status;
    if (SSL_CTX_load_verify_file(context, flags.ca_file.c_str()) != 1) {
      return FileError("--ca", flags.ca_file, absl::StrCat("holds no certificates in PEM: ", OpenSslReason()));
    }
  }
  if (flags.cert_file.empty()) return tls;
  absl::Status status = ReadWhole("--cert", flags.cert_file, &tls.options_.pem_cert_chain);
  if (status.ok()) status = ReadWhole("--key", flags.key_file, &tls.options_.pem_private_key);
  if (!status.ok()) return status;
  if (SSL_CTX_use_certificate_chain_file(context, flags.cert_file.c_str()) != 1) {
    return FileError("--cert", flags.cert_file, absl::StrCat("holds no certificate of use: ", OpenSslReason()));
  }
  if (SSL_CTX_use_PrivateKey_file(context, flags.key_file.c_str(), SSL_FILETYPE_PEM) != 1) {
    return FileError("--key", flags.key_file,
                     absl::StrCat("holds no private key of --cert in PEM without passphrase: ", OpenSslReason()));
  }
  return tls;
}

std::string Tls::WhyNot(const std::string& server) const {
  SSL* ssl = nullptr;
  const Bio bio = Connect(server, context_.get(), &ssl);
  if (bio == nullptr) return "";
  const std::string host = ExpectHost(server, ssl);
  bool asked = false;
  SSL_set_cert_cb(ssl, NoteAsked, &asked);
  if (BIO_do_handshake(bio.get()) != 1) {
    const long untrusted = SSL_get_verify_result(ssl);
    if (untrusted == X509_V_OK) return FailureText(ssl, asked);
    ERR_clear_error();
    return UntrustedText(untrusted, host, !options_.pem_root_certs.empty());
  }
  // In TLS 1.3 the server judges the client's certificate only now. A server that likes it speaks first.
  char byte;
  return BIO_read(bio.get(), &byte, 1) == 1 ? "" : FailureText(ssl, asked);
}

bool Tls::IsSpokenBy(const std::string& server) {
  const std::shared_ptr<SSL_CTX> context = NewContext();
  SSL* ssl = nullptr;
  const Bio bio = Connect(server, context.get(), &ssl);
  const bool spoken = bio != nullptr && BIO_do_handshake(bio.get()) == 1;
  ERR_clear_error();
  return spoken;
}

}  // namespace deltaray
