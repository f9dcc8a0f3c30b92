#include "tests/bench/server_process.h"

#include <signal.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <system_error>
#include <thread>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace deltaray {
namespace {

constexpr std::chrono::seconds kStartTimeout(30);

std::string BesideThisProgram() {
  std::error_code error;
  return (std::filesystem::read_symlink("/proc/self/exe", error).parent_path() / "deltarayd").string();
}

}  // namespace

absl::StatusOr<std::unique_ptr<ServerProcess>> ServerProcess::Start(std::string binary, std::string data_directory,
                                                                    const std::vector<std::string>& flags) {
  if (binary.empty()) binary = BesideThisProgram();
  if (access(binary.c_str(), X_OK) != 0) {
    return absl::NotFoundError(absl::StrCat(binary, " is missing: build the target deltarayd"));
  }
  std::string directory = (std::filesystem::temp_directory_path() / "deltaray_bench_XXXXXX").string();
  if (mkdtemp(directory.data()) == nullptr) return absl::UnavailableError("cannot make a temporary directory");
  std::unique_ptr<ServerProcess> server(new ServerProcess(directory));

  const std::string port_file = directory + "/port";
  if (data_directory.empty()) data_directory = directory + "/data";
  std::vector<std::string> words = {binary,       "--listen",     "127.0.0.1:0", "--port-file", port_file,
                                    "--data-dir", data_directory, "--log-level", "warning"};
  words.insert(words.end(), flags.begin(), flags.end());
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  const pid_t parent = getpid();
  server->process_ = fork();
  if (server->process_ < 0) return absl::UnavailableError("cannot start another process");
  if (server->process_ == 0) {
    // Only what may be called after a fork of a program with threads.
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(127);
    execv(binary.c_str(), arguments.data());
    _exit(127);
  }
  if (clock_getcpuclockid(server->process_, &server->clock_) != 0) {
    return absl::UnavailableError("the server has no clock of its processor time");
  }

  const auto deadline = std::chrono::steady_clock::now() + kStartTimeout;
  while (std::chrono::steady_clock::now() < deadline) {
    std::ifstream file(port_file);
    if (std::string port; std::getline(file, port) && !file.eof()) {
      server->address_ = absl::StrCat("127.0.0.1:", port);
      return server;
    }
    if (waitpid(server->process_, nullptr, WNOHANG) != 0) {
      server->process_ = -1;
      return absl::UnavailableError(absl::StrCat(binary, " did not start"));
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return absl::UnavailableError(absl::StrCat(binary, " did not listen"));
}

ServerProcess::~ServerProcess() {
  Kill().IgnoreError();
  std::error_code ignored;
  std::filesystem::remove_all(directory_, ignored);
}

void ServerProcess::Signal(int signal) {
  if (process_ > 0) kill(process_, signal);
}

absl::Status ServerProcess::Kill() { return End(SIGKILL); }

absl::Status ServerProcess::Stop() { return End(SIGTERM); }

absl::Status ServerProcess::End(int signal) {
  if (process_ < 0) return absl::OkStatus();
  const pid_t process = std::exchange(process_, -1);
  int status = 0;
  const bool ran = waitpid(process, &status, WNOHANG) == 0;
  if (ran) {
    kill(process, signal);
    waitpid(process, &status, 0);
  }
  const bool killed = WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL;
  const bool well = WIFEXITED(status) && WEXITSTATUS(status) == 0;
  if (ran && (signal == SIGKILL ? killed : well)) return absl::OkStatus();
  return absl::InternalError(absl::StrCat("the server at ", address_, " ended", ran ? "" : " by itself",
                                          WIFSIGNALED(status)
                                              ? absl::StrCat(", by signal ", WTERMSIG(status))
                                              : absl::StrCat(", with exit code ", WEXITSTATUS(status))));
}

double ServerProcess::CpuSeconds() const {
  timespec time;
  clock_gettime(clock_, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

}  // namespace deltaray
