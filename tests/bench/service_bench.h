// What the service costs beyond tracing: through gRPC on loopback, to a deltarayd of its own.

#ifndef TESTS_BENCH_SERVICE_BENCH_H_
#define TESTS_BENCH_SERVICE_BENCH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace deltaray {

struct ServiceBenchOptions {
  std::vector<std::string> scenes;
  std::vector<std::string> rays;  // of closest hits
  std::vector<uint32_t> streams;
  std::vector<uint32_t> batches;  // rays of a batch
  // The scene that is uploaded to see how soon it is answered from. Empty: none.
  std::string upload_scene;
  // Made by tests/certificates.sh: throughput is measured by TLS too, on a server of its own. Empty: not.
  std::string certificates;
  uint32_t size = 1024;   // see MakeRaySet
  uint32_t calls = 2000;  // that latencies are taken of
  uint32_t rounds = 5;
  std::string server;  // deltarayd; empty: the one beside this program
  std::string csv;     // "-": standard output
};

// Fails where an answer through the service is not that of the same rays in-process.
absl::Status RunServiceBench(const ServiceBenchOptions& options);

}  // namespace deltaray

#endif  // TESTS_BENCH_SERVICE_BENCH_H_
