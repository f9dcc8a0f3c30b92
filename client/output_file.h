// Writing to standard output, or to a file, with errors told apart.

#ifndef CLIENT_OUTPUT_FILE_H_
#define CLIENT_OUTPUT_FILE_H_

#include <cstdio>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace deltaray {

// Writes and flushes. A reader that has gone gives OutputClosed(), all else a LocalError. `name` is for the text.
absl::Status WriteOutput(std::FILE* file, absl::string_view data, absl::string_view name = "standard output");

// Whether a path means standard output, which is not to be opened as a file: what stands in it already would be lost.
inline bool IsStandardOutput(absl::string_view path) { return path == "-" || path == "/dev/stdout"; }

// Writes a whole file in place of the one that was there before, which a failure leaves as it was: the new one is
// written beside it, with its permissions, and renamed. What is no file, as a device or a pipe, is written to.
absl::Status WriteWholeFile(const std::string& path, absl::string_view data);

}  // namespace deltaray

#endif  // CLIENT_OUTPUT_FILE_H_
