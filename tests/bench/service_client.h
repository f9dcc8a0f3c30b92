// The calls by which the service benchmark uses a server, through the client's own code.

#ifndef TESTS_BENCH_SERVICE_CLIENT_H_
#define TESTS_BENCH_SERVICE_CLIENT_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/connection.h"
#include "deltaray/v1/ray_service.pb.h"
#include "server/geometry/ray.h"
#include "server/mesh/triangle_mesh.h"
#include "tests/bench/measure.h"

namespace deltaray {

// A connection with what it needs to live.
class BenchConnection {
 public:
  // By TLS where `ca_file` is not empty.
  static absl::StatusOr<std::unique_ptr<BenchConnection>> Open(const std::string& address,
                                                               const std::string& ca_file = "");
  Connection& operator*() { return *connection_; }
  Connection* operator->() { return &*connection_; }

 private:
  BenchConnection(const std::string& address, const std::string& ca_file)
      : session_{.input_fd = -1,
                 .output = stdout,
                 .messages = stderr,
                 .show_progress = false,
                 .stop = stop_,
                 .server = address,
                 .timeout_seconds = 60,
                 .retry_seconds = 0,  // what is lost must show
                 .security = {.ca_file = ca_file}} {}

  StopSignal stop_;
  const Session session_;
  absl::StatusOr<Connection> connection_ = absl::UnknownError("not connected");
};

// Uploads the stored arrays of `mesh`, with a name where it is not empty, and returns its id. Calls `on_last_byte` once
// all of them are sent.
absl::StatusOr<std::string> UploadArrays(Connection& connection, const TriangleMesh& mesh,
                                         const std::function<void()>& on_last_byte, const std::string& name = "");
absl::Status DeleteMesh(Connection& connection, const std::string& mesh);

// Rays as they travel: without intervals where all of them have the default one.
struct WireRays {
  explicit WireRays(std::span<const Ray> rays);

  v1::RayLayout layout;
  size_t ray_bytes;
  std::string bytes;

  // `count` rays from `first` on.
  std::string_view Some(size_t first, size_t count) const {
    return std::string_view(bytes).substr(first * ray_bytes, count * ray_bytes);
  }
  size_t size() const { return bytes.size() / ray_bytes; }
};

// One unary call, with the rays from `first` on.
absl::StatusOr<v1::CastRaysResponse> Cast(Connection& connection, const std::string& mesh, const WireRays& rays,
                                          size_t first, size_t count, v1::BuildWait wait);

// Judges a reply, to the rays from number `first` on.
using CheckHits = std::function<absl::Status(size_t first, const v1::HitBatch& hits)>;

// Streams the rays from `first` on in batches of `batch`, at the full speed of the window.
absl::Status StreamAll(Connection& connection, const std::string& mesh, const WireRays& rays, size_t first,
                       size_t count, size_t batch, const CheckHits& check);

// The times, in microseconds, that `calls` calls of `count` rays each took, one after the other: unary ones, and
// batches of a stream of which each waits for the reply to the one before. What `check` does is not in them.
absl::StatusOr<Samples> UnaryLatencies(Connection& connection, const std::string& mesh, const WireRays& rays,
                                       size_t count, size_t calls, const CheckHits& check);
absl::StatusOr<Samples> StreamLatencies(Connection& connection, const std::string& mesh, const WireRays& rays,
                                        size_t count, size_t calls, const CheckHits& check);

}  // namespace deltaray

#endif  // TESTS_BENCH_SERVICE_CLIENT_H_
