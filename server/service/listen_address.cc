#include "server/service/listen_address.h"

#include <arpa/inet.h>

#include <algorithm>
#include <cstdint>
#include <string>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"

namespace deltaray {
namespace {
constexpr uint32_t kMaxPort = 65535;
}  // namespace

absl::Status ValidateListenAddress(absl::string_view address) {
  if (absl::StartsWith(address, "unix:") && address != "unix:") return absl::OkStatus();
  const size_t colon = address.rfind(':');
  const absl::string_view host = address.substr(0, colon);
  const bool bracketed = absl::StartsWith(host, "[") && absl::EndsWith(host, "]");
  if (colon == absl::string_view::npos || host.empty() || (absl::StrContains(host, ':') && !bracketed)) {
    return absl::InvalidArgumentError(absl::StrCat("'", address, "' is neither host:port nor unix:path"));
  }
  const absl::string_view port = address.substr(colon + 1);
  uint32_t number;
  if (!std::all_of(port.begin(), port.end(), absl::ascii_isdigit) || !absl::SimpleAtoi(port, &number) ||
      number > kMaxPort) {
    return absl::InvalidArgumentError(absl::StrCat("port '", port, "' is not in the range 0 to ", kMaxPort));
  }
  return absl::OkStatus();
}

absl::Status ValidateMetricsAddress(absl::string_view address) {
  if (address.empty()) return absl::OkStatus();
  if (absl::StartsWith(address, "unix:")) {
    return absl::InvalidArgumentError(absl::StrCat("'", address, "' is not host:port"));
  }
  // The library that serves them is commonly compiled without.
  if (absl::StartsWith(address, "[")) {
    return absl::InvalidArgumentError(absl::StrCat("'", address, "' is of IPv6, where metrics are not served"));
  }
  return ValidateListenAddress(address);
}

bool IsLoopback(absl::string_view address) {
  if (absl::StartsWith(address, "unix:")) return true;
  const size_t colon = address.rfind(':');
  if (colon == absl::string_view::npos) return false;
  absl::string_view host = address.substr(0, colon);
  if (host == "localhost") return true;

  in6_addr v6;
  if (absl::ConsumePrefix(&host, "[") && absl::ConsumeSuffix(&host, "]")) {
    return inet_pton(AF_INET6, std::string(host).c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
  }
  in_addr v4;
  return inet_pton(AF_INET, std::string(host).c_str(), &v4) == 1 && (ntohl(v4.s_addr) >> 24) == 127;
}

}  // namespace deltaray
