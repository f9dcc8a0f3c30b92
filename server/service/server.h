// The whole server: store, tracing threads, handlers and gRPC.

#ifndef SERVER_SERVICE_SERVER_H_
#define SERVER_SERVICE_SERVER_H_

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/service/batch_answer.h"
#include "server/service/call_limits.h"
#include "server/service/security_options.h"
#include "server/store/mesh_store.h"

namespace deltaray {

struct ServerOptions {
  // Where to listen, as gRPC writes it: host:port or unix:path. Port 0 picks a free one.
  std::string listen = "127.0.0.1:7878";
  // Where Prometheus fetches metrics: host:port. Empty: nowhere.
  std::string metrics_listen;
  // Whether to tell of connections and calls by gRPC's channelz, to whoever asks.
  bool channelz = false;
  SecurityOptions security;
  MeshStore::Options store;
  // Threads that trace. 0: all cores.
  uint32_t threads = 0;
  BatchLimits batch;
  // Bytes that messages may take in gRPC before they are handed on, over all connections; at least four messages.
  uint64_t network_bytes = uint64_t{1} << 30;
  // Bytes that requests being answered and replies that are not taken yet may take; at least four messages.
  uint64_t batch_bytes = uint64_t{1} << 30;
  CallLimits::Options calls;
  // Calls at once on one connection; gRPC clients let further ones wait.
  uint32_t max_connection_calls = 256;
  // Connections at once; fewer where the limit on open files is low.
  uint32_t max_connections = 4096;
  // Bytes of the metadata of one call.
  uint32_t max_metadata_bytes = 16 << 10;
  // How long a stream or an upload whose client is to send or to read, or a connection without calls, may do nothing.
  std::chrono::milliseconds idle_timeout{300'000};
  // How often the server looks whether it hears and answers.
  std::chrono::milliseconds watchdog_interval{5000};
  // How long Drain waits for the calls under way.
  std::chrono::milliseconds drain_timeout{10'000};

  // What is used: four messages where that is more.
  uint64_t network_bytes_in_force() const { return std::max(network_bytes, 4 * batch.max_message_bytes); }
  uint64_t batch_bytes_in_force() const { return std::max(batch_bytes, 4 * batch.max_message_bytes); }
  // A group's name takes up to three times its bytes in a reply, and the rest of the mesh needs room there too.
  uint64_t max_group_bytes_in_force() const {
    return std::min<uint64_t>(store.mesh_limits.max_group_bytes, batch.max_message_bytes / 4);
  }
};

// A running server. All methods are thread-safe.
class Server {
 public:
  // Opens the store and listens. FAILED_PRECONDITION where the calling thread's floating-point arithmetic, which all
  // threads of the server inherit, cannot give right answers; UNAVAILABLE where the address cannot be had;
  // INVALID_ARGUMENT, naming flag and file, where a file of `security` is of no use.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const ServerOptions& options);
  // The same over a store that is open already.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const ServerOptions& options, std::unique_ptr<MeshStore> store);

  // Drains where Drain was not called, without waiting for calls under way.
  virtual ~Server() = default;

  // The port that it listens at; 0 for unix:path.
  virtual int port() const = 0;
  // The port of the metrics; 0 where there is none.
  virtual int metrics_port() const = 0;
  // Threads that trace.
  virtual uint32_t threads() const = 0;
  // Connections that are let in at once.
  virtual uint32_t max_connections() const = 0;

  // Ends the server: health says NOT_SERVING, new calls are refused with UNAVAILABLE, as are batches that wait for
  // a build; other batches under way are answered,
  // uploads, watches and idle streams end with UNAVAILABLE. What is left after drain_timeout is cut off. Returns once
  // no call is left. False: something was cut off.
  virtual bool Drain() = 0;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_SERVER_H_
