// How soon small calls are answered, and how fast one stream is, whatever else the server does.

#ifndef TESTS_TORTURE_PROBE_H_
#define TESTS_TORTURE_PROBE_H_

#include <cstdint>
#include <string>

#include "absl/status/status.h"

namespace deltaray {

struct ProbeOptions {
  std::string server;  // host:port
  std::string scene = "city";
  double seconds = 10;
  uint32_t rays = 64;  // of one call
};

// Makes a call of a few rays and a health check every 10 ms, each on a connection of its own, and prints how long they
// took, in milliseconds, and how late this program itself was woken by timers meanwhile: what the machine, and not the
// server, adds. Fails where a call fails.
absl::Status RunProbe(const ProbeOptions& options);

// Streams batches of 16,384 rays and prints the Mrays/s of one stream.
absl::Status RunSpeed(const ProbeOptions& options);

}  // namespace deltaray

#endif  // TESTS_TORTURE_PROBE_H_
