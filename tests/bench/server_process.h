// A deltarayd of its own for a benchmark.

#ifndef TESTS_BENCH_SERVER_PROCESS_H_
#define TESTS_BENCH_SERVER_PROCESS_H_

#include <sys/types.h>
#include <time.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"

namespace deltaray {

// A running deltarayd with an empty data directory, so that its processor time is told apart from the client's. It
// ends, and the directory goes, when this does; also where this process is killed.
class ServerProcess {
 public:
  // Starts `binary`; empty: the deltarayd beside this program. Adds `flags` to what it needs. Returns once it listens.
  static absl::StatusOr<std::unique_ptr<ServerProcess>> Start(std::string binary,
                                                              const std::vector<std::string>& flags = {});
  ~ServerProcess();
  ServerProcess(const ServerProcess&) = delete;
  ServerProcess& operator=(const ServerProcess&) = delete;

  // As gRPC takes it.
  const std::string& address() const { return address_; }
  // Processor time that the server has taken since its start.
  double CpuSeconds() const;

 private:
  explicit ServerProcess(std::string directory) : directory_(std::move(directory)) {}

  const std::string directory_;
  pid_t process_ = -1;
  clockid_t clock_ = 0;
  std::string address_;
};

}  // namespace deltaray

#endif  // TESTS_BENCH_SERVER_PROCESS_H_
