// How many calls there may be at once.

#ifndef SERVER_SERVICE_CALL_LIMITS_H_
#define SERVER_SERVICE_CALL_LIMITS_H_

#include <cstdint>
#include <unordered_set>

#include "server/build/mutex.h"
#include "server/service/call_watcher.h"

namespace deltaray {

// Refuses calls over a limit with RESOURCE_EXHAUSTED. A call counts until it is answered, so that a client that makes
// one after the other takes one place; there are as many more places, and some, for answers that are on their way.
// Reflection, and the health of the server and its services, are not counted: they are answered however many calls
// there are. Thread-safe.
class CallLimits final : public CallWatcher {
 public:
  struct Options {
    uint32_t calls = 4096;    // of all kinds
    uint32_t streams = 1024;  // RayService.StreamRays
    // MeshService.UploadMesh. Each holds a file of up to the size of an upload, and two messages in memory.
    uint32_t uploads = 16;
  };

  explicit CallLimits(const Options& options) : options_(options) {}

  absl::Status OnBegin(RpcInfo& rpc) override;
  void OnAnswer(const RpcInfo& rpc) override;
  void OnEnd(const RpcInfo& rpc, const absl::Status& status) override;

 private:
  const Options options_;
  Mutex mutex_;
  uint32_t calls_ ABSL_GUARDED_BY(mutex_) = 0;
  uint32_t answered_ ABSL_GUARDED_BY(mutex_) = 0;  // no longer in the other counts, but not ended
  uint32_t streams_ ABSL_GUARDED_BY(mutex_) = 0;
  uint32_t uploads_ ABSL_GUARDED_BY(mutex_) = 0;
  // Calls that were refused here and have not ended: they are not in the counts, or a client that asks again and again
  // would keep its own place taken.
  std::unordered_set<const grpc::CallbackServerContext*> refused_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CALL_LIMITS_H_
