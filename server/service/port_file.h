// Tells whoever started the server the port that it got.

#ifndef SERVER_SERVICE_PORT_FILE_H_
#define SERVER_SERVICE_PORT_FILE_H_

#include <string>

#include "absl/status/status.h"

namespace deltaray {

// Writes the port and a line end. A file is replaced as a whole, so that whoever waits for it never sees half a number:
// the new one is written beside it and renamed. A symbolic link stays, and leads to the new file. Written to are what
// is no file, as a device or a pipe, and what this process has open, by /dev/stdout or /dev/fd/3, wherever that leads;
// a named pipe waits for its reader, and meanwhile signals do what they do by default.
absl::Status WritePortFile(const std::string& path, int port);

}  // namespace deltaray

#endif  // SERVER_SERVICE_PORT_FILE_H_
