// Many streams of rays at once, fast and slow ones.

#ifndef TESTS_TORTURE_LOAD_H_
#define TESTS_TORTURE_LOAD_H_

#include <cstdint>
#include <string>

#include "absl/status/status.h"

namespace deltaray {

struct LoadOptions {
  std::string server;  // host:port
  std::string scene = "city";
  double seconds = 10;
  double longest = 0;      // seconds that it may go on for while a stream has had no batch
  uint32_t streams = 256;  // each on a connection of its own
  uint32_t slow = 64;      // streams besides, whose client takes one reply a second
  uint32_t max_batch = 1 << 20;
};

// Uploads the scene, and sends chords through it on all streams until the time is up, and each has had a batch. The
// sizes of batches are such that each power of two from 256 to max_batch is as likely as another. Answers are compared
// with those that the server gave before the load. Prints one line, which gives the batches and rays answered and the
// errors by code. Fails where an answer differs, a stream ends with a code that is not documented for overload, or has
// had no batch at the end.
absl::Status RunLoad(const LoadOptions& options);

}  // namespace deltaray

#endif  // TESTS_TORTURE_LOAD_H_
