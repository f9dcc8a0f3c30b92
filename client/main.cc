// The command line client of deltarayd.

#include <fcntl.h>
#include <grpc/grpc.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <thread>

#include "client/command_line.h"
#include "client/stop_signal.h"

namespace {

// Files and sockets opened later must not take the place of a standard stream that the client was started without: hits
// would be written into them. Opened the wrong way round, the stream fails as a closed one does.
void OpenStandardStreams() {
  for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    // Not 0 where it is closed, or closes on exec, which nothing does that came from outside: gRPC leaves an eventfd in
    // the place of a closed standard input before main begins.
    if (fcntl(stream, F_GETFD) == 0) continue;
    close(stream);
    open("/dev/null", stream == STDIN_FILENO ? O_WRONLY : O_RDONLY);
  }
}

// What still goes on of a connection that failed ends on a thread of gRPC's own, which takes down the others: a process
// that ended meanwhile would leave them within OpenSSL. Never long.
void WaitForGrpc() {
  const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds(2);
  while (grpc_is_initialized() != 0 && std::chrono::steady_clock::now() < limit) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

}  // namespace

int main(int argc, char** argv) {
  OpenStandardStreams();
  // A reader that goes away, or a limit on file sizes, shows as an error of the write, so that the RPC can be ended in
  // order, and no half of a file is left behind.
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);
  // What gRPC logs of failures is in our own messages, and for people.
  setenv("GRPC_VERBOSITY", "NONE", /*overwrite=*/0);
  // Never destroyed: the thread that waits for signals outlives main.
  static deltaray::StopSignal& stop = *new deltaray::StopSignal;
  deltaray::StopOnSignals(stop);
  deltaray::Session session = {
      .input_fd = STDIN_FILENO,
      .output = stdout,
      .messages = stderr,
      .show_progress = isatty(STDERR_FILENO) == 1,
      .stop = stop,
      .server = "127.0.0.1:7878",
      // Longer than the 10 s that a change may wait in the server for a lock, so that the server tells why.
      .timeout_seconds = 15,
  };
  if (const char* const token = std::getenv("DELTARAY_TOKEN")) session.security.token = token;
  const int code = deltaray::RunCommandLine(argc, argv, session);
  WaitForGrpc();
  return code;
}
