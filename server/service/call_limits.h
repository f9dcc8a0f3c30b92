// How many calls there may be at once.

#ifndef SERVER_SERVICE_CALL_LIMITS_H_
#define SERVER_SERVICE_CALL_LIMITS_H_

#include <cstdint>
#include <string_view>
#include <unordered_map>

#include "absl/container/inlined_vector.h"
#include "server/build/mutex.h"
#include "server/service/call_watcher.h"

namespace deltaray {

// Refuses calls over a limit with RESOURCE_EXHAUSTED. A call counts until it is answered, so that a client that makes
// one after the other takes one place; answers that their clients have yet to take have as many places again, and some.
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

  explicit CallLimits(const Options& options);

  absl::Status OnBegin(RpcInfo& rpc) override;
  void OnAnswer(const RpcInfo& rpc) override;
  void OnEnd(const RpcInfo& rpc, const absl::Status& status) override;

 private:
  // Calls of a kind.
  struct Places {
    const uint32_t limit;
    const char* what;
    const char* flag;
    uint32_t asking = 0;    // not answered yet
    uint32_t answered = 0;  // but not ended

    absl::Status HasRoom() const;
  };
  // What a call of this method takes a place of.
  absl::InlinedVector<Places*, 2> PlacesOf(std::string_view method) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  Mutex mutex_;
  Places calls_ ABSL_GUARDED_BY(mutex_), streams_ ABSL_GUARDED_BY(mutex_), uploads_ ABSL_GUARDED_BY(mutex_);
  // Whether a call was answered, of those that have a place. Calls that were refused here have none, or a client that
  // asks again and again would keep its own place taken.
  std::unordered_map<const grpc::CallbackServerContext*, bool> answered_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_CALL_LIMITS_H_
