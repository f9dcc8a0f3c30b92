// What it costs to move bytes between two sockets on this machine: the floor under what any service costs.

#ifndef TESTS_BENCH_LOOPBACK_H_
#define TESTS_BENCH_LOOPBACK_H_

#include <cstddef>

#include "absl/status/statusor.h"

namespace deltaray {

// Processor seconds of all threads for `count` requests and their replies over one TCP connection on loopback, from and
// to the same buffers, the next request under way while a reply is.
absl::StatusOr<double> MoveOverLoopback(size_t request_bytes, size_t reply_bytes, size_t count);

}  // namespace deltaray

#endif  // TESTS_BENCH_LOOPBACK_H_
