// What a command runs with: its streams, how the server is reached, and the switch that stops it.

#ifndef CLIENT_SESSION_H_
#define CLIENT_SESSION_H_

#include <cstdio>
#include <string>

#include "client/security_flags.h"
#include "client/stop_signal.h"

namespace deltaray {

struct Session {
  // Standard input, read when a file is given as "-".
  int input_fd;
  // Data goes here.
  std::FILE* output;
  // Errors, progress and remarks go here.
  std::FILE* messages;
  // Whether to draw progress bars on `messages`: where it is a terminal.
  bool show_progress;
  StopSignal& stop;
  // Address of the server in gRPC's syntax.
  std::string server;
  // Seconds that connecting may take, and each RPC that returns at once.
  double timeout_seconds;
  // Seconds that what may be asked again is asked again, while the server is lost. 0: never.
  double retry_seconds = 30;
  SecurityFlags security = {};
};

}  // namespace deltaray

#endif  // CLIENT_SESSION_H_
