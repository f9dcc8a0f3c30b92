#include "server/service/pem.h"

#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/ssl.h>
#include <openssl/x509.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

template <auto kFree>
struct Free {
  template <typename T>
  void operator()(T* pointer) const {
    kFree(pointer);
  }
};
using Bio = std::unique_ptr<BIO, Free<BIO_free_all>>;
using Certificate = std::unique_ptr<X509, Free<X509_free>>;
using Key = std::unique_ptr<EVP_PKEY, Free<EVP_PKEY_free>>;
using Context = std::unique_ptr<SSL_CTX, Free<SSL_CTX_free>>;

Bio Bytes(const ReloadedFile& file) {
  return Bio(BIO_new_mem_buf(file.bytes.data(), static_cast<int>(file.bytes.size())));
}

// Without this OpenSSL would ask for it at the terminal.
int NoPassphrase(char*, int, int, void*) { return 0; }

// Takes the reason of the last failure out of OpenSSL's queue.
std::string Reason() {
  const char* reason = ERR_reason_error_string(ERR_peek_last_error());
  ERR_clear_error();
  return reason == nullptr ? "unknown reason" : reason;
}

absl::StatusOr<std::vector<Certificate>> ReadCertificates(const ReloadedFile& file) {
  std::vector<Certificate> certificates;
  const Bio bio = Bytes(file);
  ERR_clear_error();
  while (Certificate certificate{PEM_read_bio_X509(bio.get(), nullptr, NoPassphrase, nullptr)}) {
    certificates.push_back(std::move(certificate));
  }
  const bool at_end = ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
  const std::string reason = Reason();
  if (!at_end) return file.Error(absl::StrCat("certificate ", certificates.size() + 1, " is damaged: ", reason));
  if (certificates.empty()) return file.Error("holds no certificate in PEM");
  return certificates;
}

std::string Text(const ASN1_TIME* time) {
  const Bio bio(BIO_new(BIO_s_mem()));
  ASN1_TIME_print(bio.get(), time);
  char* text;
  const long size = BIO_get_mem_data(bio.get(), &text);
  return std::string(text, size);
}

void LogValidity(const ReloadedFile& file, const X509& certificate) {
  const std::string from = Text(X509_get0_notBefore(&certificate)), until = Text(X509_get0_notAfter(&certificate));
  const bool valid = X509_cmp_current_time(X509_get0_notBefore(&certificate)) < 0 &&
                     X509_cmp_current_time(X509_get0_notAfter(&certificate)) > 0;
  spdlog::log(valid ? spdlog::level::info : spdlog::level::err, "the certificate in {} is {}valid from {} until {}",
              file.path, valid ? "" : "not valid now: it is ", from, until);
}

}  // namespace

absl::Status CheckKeyPair(const ReloadedFile& certificates, const ReloadedFile& key) {
  const absl::StatusOr<std::vector<Certificate>> chain = ReadCertificates(certificates);
  if (!chain.ok()) return chain.status();
  const Key private_key(PEM_read_bio_PrivateKey(Bytes(key).get(), nullptr, NoPassphrase, nullptr));
  if (private_key == nullptr)
    return key.Error(absl::StrCat("holds no private key in PEM without passphrase: ", Reason()));
  if (X509_check_private_key(chain->front().get(), private_key.get()) != 1) {
    ERR_clear_error();
    return key.Error(
        absl::StrCat("is not the key of the first certificate in --", certificates.flag, ", ", certificates.path));
  }
  // As gRPC will; keys may be too short for the system's security level, for instance.
  const Context context(SSL_CTX_new(TLS_server_method()));
  bool usable = SSL_CTX_use_certificate(context.get(), chain->front().get()) == 1;
  for (size_t i = 1; usable && i < chain->size(); ++i) {
    usable = SSL_CTX_add1_chain_cert(context.get(), (*chain)[i].get()) == 1;
  }
  if (!usable) return certificates.Error(absl::StrCat("is of no use to a server: ", Reason()));
  if (SSL_CTX_use_PrivateKey(context.get(), private_key.get()) != 1) {
    return key.Error(absl::StrCat("is of no use to a server: ", Reason()));
  }
  LogValidity(certificates, *chain->front());
  return absl::OkStatus();
}

absl::Status CheckAuthorities(const ReloadedFile& authorities) { return ReadCertificates(authorities).status(); }

}  // namespace deltaray
