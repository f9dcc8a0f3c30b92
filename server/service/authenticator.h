// Lets in calls that carry a token of the token file whose role is great enough.

#ifndef SERVER_SERVICE_AUTHENTICATOR_H_
#define SERVER_SERVICE_AUTHENTICATOR_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/build/mutex.h"
#include "server/service/call_watcher.h"
#include "server/service/reloaded_files.h"
#include "server/service/token_file.h"

namespace deltaray {

// A call is asked for its token once, when it comes: a stream under way outlives the token that it began with.
class Authenticator final : public CallWatcher {
 public:
  // Reads the token file, and again when it changes. INVALID_ARGUMENT where it cannot be read or is malformed; a new
  // one like that is logged, and the former tokens stay.
  static absl::StatusOr<std::unique_ptr<Authenticator>> Start(const std::string& token_file);

  // UNAUTHENTICATED without a token of the file; PERMISSION_DENIED where its role is too small for the method.
  absl::Status OnBegin(RpcInfo& rpc) override;
  void OnEnd(const RpcInfo&, const absl::Status&) override {}

 private:
  Authenticator() = default;

  Mutex mutex_;
  std::shared_ptr<const TokenTable> tokens_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<ReloadedFiles> file_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_AUTHENTICATOR_H_
