// The sockets that the server listens at, and how many connections it lets in.

#ifndef SERVER_SERVICE_LISTENER_H_
#define SERVER_SERVICE_LISTENER_H_

#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "grpcpp/server_builder.h"
#include "server/build/mutex.h"

namespace deltaray {

// Accepts connections on a thread of its own and hands them to gRPC.
//
// gRPC 1.51 could listen by itself, but has no limit on connections, and never listens again once the process was out
// of file descriptors for a moment. This one refuses connections beyond the limit, and goes on after any failure. Its
// methods are not to be called at the same time, but for those that tell numbers.
class Listener {
 public:
  // Binds `address`: host:port, all addresses that the host has, or unix:path. At most `max_connections` are let in,
  // and no more than there are file descriptors for, with some kept back for files. UNAVAILABLE, with the reason, where
  // the address cannot be had.
  static absl::StatusOr<std::unique_ptr<Listener>> Open(const std::string& address, uint32_t max_connections);
  ~Listener();

  // Lets connections in. Called once, when the server of `acceptor` has been started.
  void Start(std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> acceptor);
  // Connects to itself. Whether some connection was accepted within `patience`, by us or refused. REQUIRES: Start was
  // called.
  bool Hears(std::chrono::milliseconds patience) const;
  // Binds unix:path anew, where somebody has taken its file away. Does nothing for host:port, which nobody can take.
  absl::Status Rebind();
  // Lets no more connections in, and closes the sockets. To be called before the server is shut down.
  void Stop();

  // As given to Open, with the port that was picked.
  const std::string& address() const { return address_; }
  // The port of the first address; 0 for unix:path.
  int port() const { return port_; }
  // The limit that holds.
  uint32_t max_connections() const { return max_connections_; }
  // Connections that are open now, and how many were refused so far. Thread-safe.
  uint64_t connections() const;
  uint64_t refused() const { return refused_; }

 private:
  // A connection that gRPC has, and closes. By its socket's inode it is seen whether the number is still that socket's.
  struct Connection {
    int file;
    dev_t device;
    ino_t inode;

    bool IsOpen() const;
  };

  explicit Listener(uint32_t max_connections);
  absl::Status BindTcp(const std::string& address);
  absl::Status BindUnix(const std::string& path);
  void StartThread();
  void EndThread();
  void Run();
  // Takes all connections that wait at a socket. False: there are no file descriptors for now.
  bool AcceptAll(int socket);
  void TakeOver(int connection);
  bool HasRoom() ABSL_EXCLUSIVE_LOCKS_REQUIRED(connections_mutex_);
  // Closes it, and says so in the log. A client that were told by GOAWAY would not fail, but connect again at once.
  void Refuse(int connection);
  // Whether the file at unix_path_ is still the one that was made for it.
  bool SocketFileIsOurs() const;

  const uint32_t max_connections_;
  std::vector<int> sockets_;
  std::string address_;
  std::string unix_path_;           // to be removed at the end
  ino_t unix_inode_ = 0;            // of the socket there that is ours
  std::atomic<uint64_t> heard_{0};  // connections accepted
  int port_ = 0;
  int stop_event_ = -1;
  std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> acceptor_;
  mutable Mutex connections_mutex_;
  std::vector<Connection> connections_ ABSL_GUARDED_BY(connections_mutex_);  // some may have gone
  std::atomic<uint64_t> refused_{0};
  std::chrono::steady_clock::time_point last_sweep_, last_warning_;
  std::thread thread_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_LISTENER_H_
