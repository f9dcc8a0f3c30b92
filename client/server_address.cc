#include "client/server_address.h"

#include <algorithm>
#include <cstdint>
#include <limits>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"

namespace deltaray {
namespace {

constexpr uint32_t kMaxPort = 65535;

// The part of `host_port` behind its host; null where it has no port. An IPv6 address without brackets is all host.
absl::string_view PortOf(absl::string_view host_port) {
  const size_t bracket = host_port.rfind(']');
  const size_t colon = host_port.find(':', bracket == host_port.npos ? 0 : bracket);
  if (colon == host_port.npos) return {};
  if (bracket == host_port.npos && host_port.find(':', colon + 1) != host_port.npos) return {};
  return host_port.substr(colon + 1);
}

bool IsPort(absl::string_view text) {
  uint32_t number;
  return std::all_of(text.begin(), text.end(), absl::ascii_isdigit) && absl::SimpleAtoi(text, &number) && number >= 1 &&
         number <= kMaxPort;
}

}  // namespace

std::string WrongWithServerAddress(absl::string_view address) {
  for (const char* scheme : {"unix:", "unix-abstract:", "xds:", "google-c2p:"}) {
    if (absl::StartsWith(address, scheme)) return "";
  }
  absl::string_view rest = address;
  const bool many = absl::ConsumePrefix(&rest, "ipv4:") || absl::ConsumePrefix(&rest, "ipv6:");
  if (many || absl::ConsumePrefix(&rest, "dns:")) {
    // The authority is the name server to ask.
    if (absl::ConsumePrefix(&rest, "//")) rest.remove_prefix(std::min(rest.find('/'), rest.size()));
    absl::ConsumePrefix(&rest, "/");
  }
  // URIs may write the brackets so.
  const std::string decoded = absl::StrReplaceAll(rest, {{"%5B", "["}, {"%5b", "["}, {"%5D", "]"}, {"%5d", "]"}});
  for (const absl::string_view host_port :
       absl::StrSplit(decoded, absl::MaxSplits(',', many ? std::numeric_limits<int>::max() : 0))) {
    const absl::string_view port = PortOf(host_port);
    if (port.data() == nullptr) return absl::StrCat("'", address, "' has no port");
    if (!IsPort(port)) {
      return absl::StrCat("'", address, "': port '", port, "' is not in the range 1 to ", kMaxPort);
    }
  }
  return "";
}

}  // namespace deltaray
