// The program: parses a command line and runs the command that it names.

#ifndef CLIENT_COMMAND_LINE_H_
#define CLIENT_COMMAND_LINE_H_

#include "client/session.h"

namespace deltaray {

// Runs one command line and returns the exit code; see exit_code.h. The session's server and timeout are the defaults,
// which DELTARAY_SERVER, --server and --timeout override.
int RunCommandLine(int argc, const char* const* argv, Session& session);

}  // namespace deltaray

#endif  // CLIENT_COMMAND_LINE_H_
