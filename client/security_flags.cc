#include "client/security_flags.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>

#include "CLI/App.hpp"
#include "CLI/Config.hpp"
#include "CLI/Formatter.hpp"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/exit_code.h"

namespace deltaray {

bool StaysHere(const std::string& server) {
  for (const char* prefix : {"localhost:", "[::1]:", "unix:"}) {
    if (absl::StartsWith(server, prefix)) return true;
  }
  // 127.example.com is elsewhere.
  return absl::StartsWith(server, "127.") && server.find_first_not_of("0123456789.:") == std::string::npos;
}

void AddSecurityFlags(CLI::App& app, SecurityFlags& flags) {
  const char* const group = "Security";
  app.add_flag("--tls", flags.tls, "Encrypt the connection; --ca, --cert and --key mean it too")
      ->envname("DELTARAY_TLS")
      ->group(group);
  const auto add_file = [&](const char* flag, std::string& file, const char* variable, const char* help) {
    app.add_option(flag, file, help)->envname(variable)->type_name("FILE")->group(group);
  };
  add_file("--ca", flags.ca_file, "DELTARAY_CA", "Authorities that the server's certificate may come from, in PEM");
  add_file("--cert", flags.cert_file, "DELTARAY_CERT", "Certificate to show the server, in PEM");
  add_file("--key", flags.key_file, "DELTARAY_KEY", "Private key of that certificate, in PEM");
  // DELTARAY_TOKEN_FILE is the server's, whose container runs this program too, as its health check.
  add_file("--token-file", flags.token_file, "DELTARAY_CLIENT_TOKEN_FILE",
           "File whose first line is the token to send; the token itself may be in the environment's DELTARAY_TOKEN");
  app.add_flag("--insecure-token", flags.insecure_token, "Send the token to another machine without TLS too")
      ->envname("DELTARAY_INSECURE_TOKEN")
      ->group(group);
}

absl::StatusOr<std::string> ReadToken(const SecurityFlags& flags, const std::string& server) {
  std::string token = flags.token;
  const char* source = "DELTARAY_TOKEN";
  if (!flags.token_file.empty()) {
    source = flags.token_file.c_str();
    std::ifstream file(flags.token_file);
    if (!file) return LocalError(absl::StrCat("--token-file: ", source, ": ", std::strerror(errno)));
    std::getline(file, token);
    token = std::string(absl::StripAsciiWhitespace(token));
    if (token.empty()) return LocalError(absl::StrCat("--token-file: ", source, ": its first line is empty"));
  }
  // gRPC ends the process for what no header can hold.
  if (!std::all_of(token.begin(), token.end(), absl::ascii_isgraph)) {
    return LocalError(absl::StrCat(source, ": a token has only printable ASCII characters and no blanks"));
  }
  if (token.empty() || flags.UsesTls() || flags.insecure_token || StaysHere(server)) return token;
  return UsageError(absl::StrCat("the token would travel to ", server,
                                 " in plaintext: use --tls, or say --insecure-token if that is meant"));
}

}  // namespace deltaray
