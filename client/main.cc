// The command line client of deltarayd.

#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>

#include "client/command_line.h"
#include "client/stop_signal.h"

int main(int argc, char** argv) {
  // A reader that goes away shows as an error of the write, so that the RPC can be ended in order.
  std::signal(SIGPIPE, SIG_IGN);
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
      .timeout_seconds = 10,
  };
  if (const char* const token = std::getenv("DELTARAY_TOKEN")) session.security.token = token;
  return deltaray::RunCommandLine(argc, argv, session);
}
