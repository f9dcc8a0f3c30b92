#include "server/service/connection_guard.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <optional>
#include <system_error>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

// An IPv4 address as the IPv6 address that stands for it.
struct Endpoint {
  in6_addr address;
  in_port_t port;  // in network order

  bool operator==(const Endpoint& other) const {
    return port == other.port && std::memcmp(&address, &other.address, sizeof(address)) == 0;
  }
};

Endpoint FromIpv4(const in_addr& address, in_port_t port) {
  Endpoint endpoint{{}, port};
  endpoint.address.s6_addr[10] = endpoint.address.s6_addr[11] = 0xff;
  std::memcpy(endpoint.address.s6_addr + 12, &address, sizeof(address));
  return endpoint;
}

// Reads ipv4:1.2.3.4:5 or ipv6:%5B::1%5D:5.
std::optional<Endpoint> ParsePeer(const std::string& peer) {
  const std::string text = absl::StrReplaceAll(peer, {{"%5B", ""}, {"%5D", ""}, {"[", ""}, {"]", ""}, {"%25", "%"}});
  const size_t colon = text.rfind(':');
  uint32_t port = 0;
  if (colon == std::string::npos || !absl::SimpleAtoi(text.substr(colon + 1), &port)) return std::nullopt;
  absl::string_view host = absl::string_view(text).substr(0, colon);
  if (absl::ConsumePrefix(&host, "ipv4:")) {
    in_addr address;
    if (inet_pton(AF_INET, std::string(host).c_str(), &address) != 1) return std::nullopt;
    return FromIpv4(address, htons(static_cast<in_port_t>(port)));
  }
  if (!absl::ConsumePrefix(&host, "ipv6:")) return std::nullopt;
  // The scope of a link-local address is not compared.
  host = host.substr(0, host.find('%'));
  Endpoint endpoint{{}, htons(static_cast<in_port_t>(port))};
  if (inet_pton(AF_INET6, std::string(host).c_str(), &endpoint.address) != 1) return std::nullopt;
  return endpoint;
}

std::optional<Endpoint> PeerOf(int socket) {
  sockaddr_storage name{};
  socklen_t length = sizeof(name);
  if (getpeername(socket, reinterpret_cast<sockaddr*>(&name), &length) != 0) return std::nullopt;
  if (name.ss_family == AF_INET) {
    const auto& ipv4 = reinterpret_cast<const sockaddr_in&>(name);
    return FromIpv4(ipv4.sin_addr, ipv4.sin_port);
  }
  if (name.ss_family != AF_INET6) return std::nullopt;
  const auto& ipv6 = reinterpret_cast<const sockaddr_in6&>(name);
  return Endpoint{ipv6.sin6_addr, ipv6.sin6_port};
}

}  // namespace

bool ShutDownConnection(const std::string& peer) {
  const std::optional<Endpoint> wanted = ParsePeer(peer);
  if (!wanted) return false;
  bool found = false;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd", error)) {
    int file = -1;
    struct stat status;
    if (!absl::SimpleAtoi(entry.path().filename().string(), &file)) continue;
    if (fstat(file, &status) != 0 || !S_ISSOCK(status.st_mode)) continue;
    // gRPC may close it at any time, and its number be another's then.
    const int copy = fcntl(file, F_DUPFD_CLOEXEC, 0);
    if (copy < 0) continue;
    if (PeerOf(copy) == wanted) found |= shutdown(copy, SHUT_RDWR) == 0;
    close(copy);
  }
  return found;
}

absl::Status ConnectionGuard::OnBegin(RpcInfo& rpc) {
  const std::string& peer = rpc.record->peer;
  {
    MutexLock lock(mutex_);
    if (++calls_[peer] <= limit_) return absl::OkStatus();
    // All clients of a unix socket are one peer, and are of this machine.
    if (!absl::StartsWith(peer, "ip")) return absl::OkStatus();
    // One call closes it.
    if (calls_[peer] > limit_ + 1) return Refusal();
  }
  if (ShutDownConnection(peer)) {
    spdlog::warn(
        "closed the connection of {}: more than {} of its calls have not ended, as of a client that resets them", peer,
        limit_);
  }
  return Refusal();
}

absl::Status ConnectionGuard::Refusal() const {
  return absl::ResourceExhaustedError(absl::StrCat("more than ", limit_, " calls of the connection have not ended"));
}

void ConnectionGuard::OnEnd(const RpcInfo& rpc, const absl::Status&) {
  MutexLock lock(mutex_);
  const auto it = calls_.find(rpc.record->peer);
  if (--it->second == 0) calls_.erase(it);
}

}  // namespace deltaray
