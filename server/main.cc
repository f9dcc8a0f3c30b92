// deltarayd: the server.

#include <fcntl.h>
#include <malloc.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <exception>
#include <iostream>
#include <string>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "server/flags.h"
#include "server/service/exit_deadline.h"
#include "server/service/log.h"
#include "server/service/port_file.h"
#include "server/service/server.h"
#include "spdlog/sinks/stdout_color_sinks.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr int kFailure = 1;
constexpr int kUsage = 2;
constexpr int kHung = 3;
// What the end may take after the drain, until it counts as hung.
constexpr std::chrono::seconds kEndTime{10};

// One file descriptor a connection: take as many as the system lets us.
void RaiseFileLimit() {
  rlimit limit;
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  if (setrlimit(RLIMIT_NOFILE, &limit) != 0) spdlog::warn("cannot raise the limit on open files");
}

// What is freed stays with malloc, for the messages of batches that come next: they would fault in their pages anew,
// which takes half of the throughput where page faults are expensive. What meshes and trees took, TreeBudget has given
// back.
void KeepFreedMessages() {
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, 64 << 20);
}

// Files opened later must not take the place of a standard stream that the server was started without.
void OpenStandardStreams() {
  int file;
  do file = open("/dev/null", O_RDWR | O_CLOEXEC);
  while (file >= 0 && file <= STDERR_FILENO);
  if (file >= 0) close(file);
}

int Run(const Flags& flags) {
  // Before any thread is started, so that all of them inherit it and only sigwait below gets these signals.
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGHUP);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  // Both are told by errno too, to the one call that they concern; the signals would end the server.
  signal(SIGPIPE, SIG_IGN);
  signal(SIGXFSZ, SIG_IGN);
  RaiseFileLimit();
  KeepFreedMessages();

  ExitDeadline deadline(kHung);
  const ServerOptions& options = flags.server;
  absl::StatusOr<std::unique_ptr<Server>> server = Server::Start(options);
  if (!server.ok()) {
    spdlog::critical("cannot start: {}", std::string(server.status().message()));
    return kFailure;
  }
  if (!flags.port_file.empty()) {
    if (absl::Status status = WritePortFile(flags.port_file, (*server)->port()); !status.ok()) {
      spdlog::critical("{}", std::string(status.message()));
      return kFailure;
    }
  }
  LogEvent(spdlog::level::info, "listens",
           {{"address", options.listen},
            {"port", int64_t{(*server)->port()}},
            {"metrics_port", int64_t{(*server)->metrics_port()}},
            {"tracing_threads", int64_t{(*server)->threads()}},
            {"max_connections", int64_t{(*server)->max_connections()}}});

  int received = 0;
  sigwait(&signals, &received);
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  spdlog::info("{}: draining, for at most {} s", absl::StrCat("SIG", sigabbrev_np(received)), flags.drain_seconds);
  deadline.Begin(options.drain_timeout + kEndTime);
  if (!(*server)->Drain()) spdlog::warn("some calls were cut off");
  server->reset();
  spdlog::info("ended");
  return 0;
}

int Main(int argc, char** argv) {
  OpenStandardStreams();
  Flags flags;
  flags.server.store.data_directory = "deltaray-data";
  CLI::App app("deltarayd: answers ray queries on triangle meshes, over gRPC.", "deltarayd");
  AddFlags(app, flags);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    if (app.exit(e) != 0) return kUsage;
    if (std::cout.flush()) return 0;
    std::fprintf(stderr, "deltarayd: cannot write standard output: %s\n", std::strerror(errno));
    return kFailure;
  }
  if (absl::Status status = FinishFlags(app, flags); !status.ok()) {
    std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
    return kUsage;
  }
  spdlog::set_default_logger(spdlog::stderr_color_mt("deltarayd"));
  spdlog::set_formatter(MakeLogFormatter(flags.log_format == "json" ? LogFormat::kJson : LogFormat::kText));
  spdlog::set_level(spdlog::level::from_str(flags.log_level));
  TakeLibraryLogs();
  LogFlags(app, flags.server);
  return Run(flags);
}

}  // namespace
}  // namespace deltaray

int main(int argc, char** argv) {
  try {
    return deltaray::Main(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "deltarayd: %s\n", e.what());
    return 1;
  }
}
