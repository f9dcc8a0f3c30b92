// Servers that share a data directory, and clients that choose among them.

#ifndef TESTS_TORTURE_FLEET_H_
#define TESTS_TORTURE_FLEET_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/build/mutex.h"
#include "tests/bench/server_process.h"
#include "tests/bench/service_client.h"

namespace deltaray {

// Started, killed and stopped by one thread; any thread may ask for addresses.
class Fleet {
 public:
  // `servers` servers on `data_directory`, which stays. Each has little memory for trees, so that they come and go.
  Fleet(int servers, std::string binary, std::string data_directory);

  int size() const { return static_cast<int>(servers_.size()); }
  const std::string& data_directory() const { return data_directory_; }
  // Starts those that do not run.
  absl::Status Start();
  // Ends one as a power cut would. Fails where it had ended by itself.
  absl::Status Kill(int server);
  // Ends all that run by SIGTERM. Fails where one had ended by itself, or does not end well.
  absl::Status Stop();
  void Signal(int server, int signal) { servers_[server]->Signal(signal); }

  // Of the process that runs as `server` now, or ran last.
  std::string address(int server) const;

 private:
  const std::string binary_;
  const std::string data_directory_;
  std::vector<std::unique_ptr<ServerProcess>> servers_;  // null: does not run
  mutable Mutex mutex_;
  std::vector<std::string> addresses_ ABSL_GUARDED_BY(mutex_);
};

// A client with a connection to each server. Not thread-safe.
class FleetClient {
 public:
  explicit FleetClient(const Fleet& fleet) : fleet_(fleet), connections_(fleet.size()) {}

  // A connection to `server`, opened again where it was restarted or Drop was called.
  absl::StatusOr<Connection*> To(int server);
  // Cuts the connection.
  void Drop(int server) { connections_[server].connection.reset(); }

 private:
  struct Known {
    std::string address;
    std::unique_ptr<BenchConnection> connection;
  };
  const Fleet& fleet_;
  std::vector<Known> connections_;
};

// What service_client.h lacks.
absl::StatusOr<v1::Mesh> GetMesh(Connection& connection, const std::string& mesh);
absl::StatusOr<std::vector<v1::Mesh>> ListMeshes(Connection& connection);
absl::Status NameMesh(Connection& connection, const std::string& name, const std::string& mesh);
absl::Status RebuildMesh(Connection& connection, const std::string& mesh, uint32_t delta);

}  // namespace deltaray

#endif  // TESTS_TORTURE_FLEET_H_
