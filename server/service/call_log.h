// Request ids, and a line in the log for every call.

#ifndef SERVER_SERVICE_CALL_LOG_H_
#define SERVER_SERVICE_CALL_LOG_H_

#include <atomic>
#include <cstdint>
#include <string>

#include "server/service/call_watcher.h"

namespace deltaray {

// Gives each call its request id: that of the metadata `x-request-id` where it is 1 to 64 visible ASCII characters,
// else one of our own. It travels back in the trailing metadata of the same name. Thread-safe.
//
// A call that has ended is logged: at debug where it is OK, at warning where the server is at fault (UNKNOWN, INTERNAL,
// DATA_LOSS), else at info.
class CallLog final : public CallWatcher {
 public:
  CallLog();

  absl::Status OnBegin(RpcInfo& rpc) override;
  void OnEnd(const RpcInfo& rpc, const absl::Status& status) override;

 private:
  // Differs from server to server and from start to start.
  const std::string prefix_;
  std::atomic<uint64_t> last_{0};
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CALL_LOG_H_
