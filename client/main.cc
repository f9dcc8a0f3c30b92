// The command line client of deltarayd.

#include <unistd.h>

#include <csignal>
#include <cstdio>

#include "client/command_line.h"
#include "client/stop_signal.h"

int main(int argc, char** argv) {
  // A reader that goes away shows as an error of the write, so that the RPC can be ended in order.
  std::signal(SIGPIPE, SIG_IGN);
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
  return deltaray::RunCommandLine(argc, argv, session);
}
