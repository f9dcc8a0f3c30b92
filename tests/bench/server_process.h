// A deltarayd of its own, for benchmarks and torture.

#ifndef TESTS_BENCH_SERVER_PROCESS_H_
#define TESTS_BENCH_SERVER_PROCESS_H_

#include <sys/types.h>
#include <time.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace deltaray {

// A running deltarayd, by default with an empty data directory, so that its processor time is told apart from the
// client's. It is killed, and that directory goes, when this is destroyed. Where this process is killed, or the thread
// that started it ends, the server is killed too, but the directory stays.
class ServerProcess {
 public:
  // Starts `binary`; empty: the deltarayd beside this program. With a data directory, that one is used, and stays.
  // Returns once it listens.
  static absl::StatusOr<std::unique_ptr<ServerProcess>> Start(std::string binary, std::string data_directory = "",
                                                              const std::vector<std::string>& flags = {});
  ~ServerProcess();
  ServerProcess(const ServerProcess&) = delete;
  ServerProcess& operator=(const ServerProcess&) = delete;

  // As gRPC takes it.
  const std::string& address() const { return address_; }
  void Signal(int signal);
  // Ends it as a power cut would. Fails where it had ended by itself.
  absl::Status Kill();
  // Ends it by SIGTERM, and waits for it. Fails where it had ended by itself, or ends with another exit code than 0, as
  // after a sanitizer's report.
  absl::Status Stop();
  // Processor time that the server has taken since its start.
  double CpuSeconds() const;

 private:
  explicit ServerProcess(std::string directory) : directory_(std::move(directory)) {}
  absl::Status End(int signal);

  const std::string directory_;
  pid_t process_ = -1;
  clockid_t clock_ = 0;
  std::string address_;
};

}  // namespace deltaray

#endif  // TESTS_BENCH_SERVER_PROCESS_H_
