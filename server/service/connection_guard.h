// Ends connections that begin calls faster than the server can end them.

#ifndef SERVER_SERVICE_CONNECTION_GUARD_H_
#define SERVER_SERVICE_CONNECTION_GUARD_H_

#include <cstdint>
#include <string>
#include <unordered_map>

#include "server/build/mutex.h"
#include "server/service/call_watcher.h"

namespace deltaray {

// HTTP/2 limits the calls of a connection that its client has not given up. A client that begins calls and resets them
// at once never meets that limit, and gRPC 1.51 keeps 20 KB of each until it comes to end it. So connections with more
// calls that have not ended, than any client that means it can have, are closed. Thread-safe.
class ConnectionGuard final : public CallWatcher {
 public:
  // `max_connection_calls`: how many calls HTTP/2 lets a connection have.
  explicit ConnectionGuard(uint32_t max_connection_calls) : limit_(kLag * max_connection_calls + kMoreLag) {}

  // RESOURCE_EXHAUSTED, and the connection is closed, where it has too many.
  absl::Status OnBegin(RpcInfo& rpc) override;
  void OnEnd(const RpcInfo& rpc, const absl::Status& status) override;

 private:
  absl::Status Refusal() const;

  // Calls that are over for the client may have yet to end here.
  static constexpr uint32_t kLag = 4, kMoreLag = 64;

  const uint32_t limit_;
  Mutex mutex_;
  // Calls that have not ended, by peer. No entry: none.
  std::unordered_map<std::string, uint32_t> calls_ ABSL_GUARDED_BY(mutex_);
};

// Shuts the TCP connection of this process with `peer`, as gRPC writes it, down for both directions. False: there is
// none.
bool ShutDownConnection(const std::string& peer);

}  // namespace deltaray

#endif  // SERVER_SERVICE_CONNECTION_GUARD_H_
