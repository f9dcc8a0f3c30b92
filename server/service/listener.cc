#include "server/service/listener.h"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

// File descriptors that are not for connections: files of uploads and meshes, logs, what gRPC and the system need.
constexpr rlim_t kReservedFiles = 128;
constexpr int kBacklog = 1024;
// How long to wait when there are no file descriptors.
constexpr int kRetryMs = 50;
// Least time between two looks at which connections have gone.
constexpr std::chrono::milliseconds kSweepInterval(10);
constexpr std::chrono::seconds kWarningInterval(10);

absl::Status Unavailable(const std::string& address, absl::string_view reason) {
  return absl::UnavailableError(absl::StrCat("cannot listen at ", address, ": ", reason));
}

uint32_t ConnectionsThatFit(uint32_t wanted) {
  rlimit limit;
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return wanted;
  const rlim_t reserve = std::min(kReservedFiles, limit.rlim_cur / 2);
  return static_cast<uint32_t>(std::min<rlim_t>(wanted, limit.rlim_cur - reserve));
}

}  // namespace

Listener::Listener(uint32_t max_connections)
    : max_connections_(ConnectionsThatFit(max_connections)), stop_event_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}

absl::StatusOr<std::unique_ptr<Listener>> Listener::Open(const std::string& address, uint32_t max_connections) {
  std::unique_ptr<Listener> listener(new Listener(max_connections));
  if (listener->stop_event_ < 0) return Unavailable(address, std::strerror(errno));
  absl::string_view path = address;
  const absl::Status status =
      absl::ConsumePrefix(&path, "unix:") ? listener->BindUnix(std::string(path)) : listener->BindTcp(address);
  if (!status.ok()) return status;
  return listener;
}

Listener::~Listener() {
  Stop();
  close(stop_event_);
}

absl::Status Listener::BindTcp(const std::string& address) {
  const size_t colon = address.rfind(':');
  absl::string_view host = absl::string_view(address).substr(0, colon);
  if (absl::ConsumePrefix(&host, "[")) absl::ConsumeSuffix(&host, "]");
  addrinfo hints{};
  hints.ai_flags = AI_PASSIVE;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const int error = getaddrinfo(std::string(host).c_str(), address.substr(colon + 1).c_str(), &hints, &found);
  if (error != 0) return Unavailable(address, gai_strerror(error));
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> addresses(found, freeaddrinfo);

  std::string reason = "it has no address";
  for (const addrinfo* one = found; one != nullptr; one = one->ai_next) {
    sockaddr_storage name{};
    std::memcpy(&name, one->ai_addr, one->ai_addrlen);
    // The port that the first address was given is for all of them.
    in_port_t& port = one->ai_family == AF_INET6 ? reinterpret_cast<sockaddr_in6&>(name).sin6_port
                                                 : reinterpret_cast<sockaddr_in&>(name).sin_port;
    if (port_ != 0) port = htons(static_cast<in_port_t>(port_));
    const int socket_file = socket(one->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    const int on = 1;
    if (socket_file >= 0) setsockopt(socket_file, SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
    if (socket_file < 0 || bind(socket_file, reinterpret_cast<sockaddr*>(&name), one->ai_addrlen) != 0 ||
        listen(socket_file, kBacklog) != 0) {
      reason = std::strerror(errno);
      const bool taken = errno == EADDRINUSE;
      if (socket_file >= 0) close(socket_file);
      // Half of a name would be served, and the other half be someone else's.
      if (taken) return Unavailable(address, reason);
      continue;
    }
    sockets_.push_back(socket_file);
    socklen_t length = sizeof(name);
    getsockname(socket_file, reinterpret_cast<sockaddr*>(&name), &length);
    port_ = ntohs(port);
  }
  address_ = absl::StrCat(address.substr(0, colon + 1), port_);
  return sockets_.empty() ? Unavailable(address, reason) : absl::OkStatus();
}

absl::Status Listener::BindUnix(const std::string& path) {
  const std::string address = absl::StrCat("unix:", path);
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  if (path.size() >= sizeof(name.sun_path)) return Unavailable(address, "the path is too long");
  std::memcpy(name.sun_path, path.c_str(), path.size());
  const auto* const any_name = reinterpret_cast<const sockaddr*>(&name);
  sockets_.push_back(socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  // A socket that nobody listens at is left over from a server that was killed.
  struct stat file;
  if (stat(path.c_str(), &file) == 0 && S_ISSOCK(file.st_mode)) {
    // Who listens may have no room for one more; to wait for that could take forever.
    const int probe = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (connect(probe, any_name, sizeof(name)) != 0 && errno == ECONNREFUSED) unlink(path.c_str());
    close(probe);
  }
  if (bind(sockets_[0], any_name, sizeof(name)) != 0 || listen(sockets_[0], kBacklog) != 0) {
    const std::string reason = std::strerror(errno);
    close(sockets_[0]);
    sockets_.clear();
    return Unavailable(address, reason);
  }
  address_ = address;
  unix_path_ = path;
  unix_inode_ = stat(path.c_str(), &file) == 0 ? file.st_ino : 0;
  return absl::OkStatus();
}

void Listener::Start(std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> acceptor) {
  acceptor_ = std::move(acceptor);
  StartThread();
}

bool Listener::Hears(std::chrono::milliseconds patience) const {
  sockaddr_storage name{};
  socklen_t length = sizeof(name);
  if (sockets_.empty() || getsockname(sockets_[0], reinterpret_cast<sockaddr*>(&name), &length) != 0) return false;
  const uint64_t heard_before = heard_;
  const int probe = socket(name.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (probe < 0) return false;
  const auto deadline = std::chrono::steady_clock::now() + patience;
  const bool gone =
      connect(probe, reinterpret_cast<sockaddr*>(&name), length) != 0 && errno != EINPROGRESS && errno != EAGAIN;
  while (!gone && heard_ == heard_before && std::chrono::steady_clock::now() < deadline) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  close(probe);
  return heard_ != heard_before;
}

absl::Status Listener::Rebind() {
  if (unix_path_.empty() || SocketFileIsOurs()) return absl::OkStatus();
  EndThread();
  for (const int socket : std::exchange(sockets_, {})) close(socket);
  const absl::Status status = BindUnix(unix_path_);
  StartThread();
  return status;
}

void Listener::StartThread() {
  thread_ = std::thread([this] { Run(); });
}

void Listener::EndThread() {
  if (!thread_.joinable()) return;
  // Neither fails: the counter is far from full, and not zero.
  uint64_t one = 1;
  [[maybe_unused]] ssize_t done = write(stop_event_, &one, sizeof(one));
  thread_.join();
  done = read(stop_event_, &one, sizeof(one));
}

void Listener::Stop() {
  EndThread();
  for (const int socket : std::exchange(sockets_, {})) close(socket);
  // Where it was removed, another server may listen at that path by now.
  if (!unix_path_.empty() && SocketFileIsOurs()) unlink(unix_path_.c_str());
  unix_path_.clear();
}

bool Listener::SocketFileIsOurs() const {
  struct stat file;
  return stat(unix_path_.c_str(), &file) == 0 && file.st_ino == unix_inode_;
}

void Listener::Run() {
  std::vector<pollfd> waiting = {{stop_event_, POLLIN, 0}};
  for (const int socket : sockets_) waiting.push_back({socket, POLLIN, 0});
  bool short_of_files = false;
  while (true) {
    // Without file descriptors the sockets stay readable: wait a while, for the end only.
    const int ready = short_of_files ? poll(waiting.data(), 1, kRetryMs) : poll(waiting.data(), waiting.size(), -1);
    if (ready < 0 && errno != EINTR) std::this_thread::sleep_for(std::chrono::milliseconds(kRetryMs));
    if (ready > 0 && waiting[0].revents != 0) return;
    const bool was_short = std::exchange(short_of_files, false);
    for (const int socket : sockets_) short_of_files |= !AcceptAll(socket);
    if (short_of_files && !was_short) {
      spdlog::warn("no file descriptors for new connections; trying again every {} ms", kRetryMs);
    }
  }
}

bool Listener::AcceptAll(int socket) {
  while (true) {
    const int connection = accept4(socket, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (connection >= 0) {
      ++heard_;
      TakeOver(connection);
    } else if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM) {
      return false;
    } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
      return true;
    }
    // All other errors are of a connection that has gone already.
  }
}

void Listener::TakeOver(int connection) {
  struct stat file;
  bool has_room = fstat(connection, &file) == 0;
  if (has_room) {
    MutexLock lock(connections_mutex_);
    has_room = HasRoom();
    if (has_room) connections_.push_back({connection, file.st_dev, file.st_ino});
  }
  if (!has_room) return Refuse(connection);
  // Fails for unix:path, which needs it not.
  const int on = 1;
  setsockopt(connection, IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
  grpc::experimental::ExternalConnectionAcceptor::NewConnectionParameters parameters;
  parameters.fd = connection;
  acceptor_->HandleNewConnection(&parameters);
}

bool Listener::HasRoom() {
  if (connections_.size() < max_connections_) return true;
  const auto now = std::chrono::steady_clock::now();
  if (now - last_sweep_ < kSweepInterval) return false;
  last_sweep_ = now;
  std::erase_if(connections_, [](const Connection& connection) { return !connection.IsOpen(); });
  return connections_.size() < max_connections_;
}

bool Listener::Connection::IsOpen() const {
  struct stat found;
  return fstat(file, &found) == 0 && found.st_dev == device && found.st_ino == inode;
}

uint64_t Listener::connections() const {
  MutexLock lock(connections_mutex_);
  return static_cast<uint64_t>(std::ranges::count_if(connections_, &Connection::IsOpen));
}

void Listener::Refuse(int connection) {
  close(connection);
  ++refused_;
  const auto now = std::chrono::steady_clock::now();
  if (now - last_warning_ < kWarningInterval) return;
  last_warning_ = now;
  spdlog::warn("connections are refused: {} are open, which is the limit (--max-connections)", max_connections_);
}

}  // namespace deltaray
