// What looks at every call from outside of it: who may call, how much at once, what is counted and logged.

#ifndef SERVER_SERVICE_CALL_WATCHER_H_
#define SERVER_SERVICE_CALL_WATCHER_H_

#include <atomic>
#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "grpcpp/server_context.h"

namespace deltaray {

// What is noted of a call while it is under way. Lives as long as the call.
struct CallRecord {
  // Both set before the call does anything.
  std::string request_id;
  std::string peer;
  std::atomic<uint64_t> batches{0};
  std::atomic<uint64_t> rays{0};
};

// A call as it is known before its first message.
struct RpcInfo {
  std::string_view method;                         // service and method, as "MeshService/GetMesh"; a literal
  grpc::CallbackServerContext* context = nullptr;  // gRPC's; valid until OnEnd has returned
  std::chrono::steady_clock::time_point began = std::chrono::steady_clock::now();
  CallRecord* record = nullptr;  // set by Calls
};

// Thread-safe; no method may block.
class CallWatcher {
 public:
  virtual ~CallWatcher() = default;

  // A call has come. Where not OK, the call ends with this status, and watchers after this one do not see it.
  virtual absl::Status OnBegin(RpcInfo& rpc) = 0;
  // A call whose OnBegin was asked is about to be answered: once it is, its client may come again, before OnEnd. Comes
  // once.
  virtual void OnAnswer(const RpcInfo& /*rpc*/) {}
  // A call whose OnBegin was asked has ended; gRPC is done with it. `status` is what its client was told.
  virtual void OnEnd(const RpcInfo& rpc, const absl::Status& status) = 0;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CALL_WATCHER_H_
