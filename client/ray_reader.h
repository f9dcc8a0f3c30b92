// Reading rays from a file or pipe, a batch at a time.

#ifndef CLIENT_RAY_READER_H_
#define CLIENT_RAY_READER_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/input_file.h"
#include "client/session.h"
#include "deltaray/v1/ray_service.pb.h"

namespace deltaray {

// A source of rays in one layout. Holds one batch at most, never the whole file. Not thread-safe.
class RayReader {
 public:
  virtual ~RayReader() = default;

  // Layout of all rays of this source.
  virtual v1::RayLayout layout() const = 0;

  // Appends up to `limit` rays in that layout to `rays` and returns how many; 0 once the file has ended. Errors are
  // LocalErrors that name the file and the line or byte.
  virtual absl::StatusOr<size_t> Read(size_t limit, std::string* rays) = 0;
};

// Bytes of one ray.
size_t RayBytes(v1::RayLayout layout);

// Rays as text, one a line, fields separated by commas:
//  - A first line that does not begin with a number names the columns: ox, oy, oz, dx, dy, dz, and either both or none
//    of t_min, t_max, in any order. Without it there are 6 or 8 columns in that order; the first ray decides.
//  - Each line has all fields; spaces around them are ignored. Origin and direction are finite, t_min and t_max not NaN
//    ("inf" and "-inf" are taken). Numbers are rounded to the nearest float64; those too large for it are refused.
//  - Empty lines and lines that begin with '#' are skipped. LF and CR LF end lines; a line has at most 4095 bytes.
//  - A byte order mark at the beginning is skipped.
// The rays are sent as float64. Reads the file's beginning to learn the layout.
absl::StatusOr<std::unique_ptr<RayReader>> OpenCsvRays(InputFile file);

// Rays as the bytes that are sent. A file that ends inside a ray is an error.
std::unique_ptr<RayReader> OpenRawRays(InputFile file, v1::RayLayout layout);

// Rays of the file at `path`, or of standard input for "-": raw ones of `raw_layout`, else CSV.
absl::StatusOr<std::unique_ptr<RayReader>> OpenRays(const std::string& path, std::optional<v1::RayLayout> raw_layout,
                                                    const Session& session);

}  // namespace deltaray

#endif  // CLIENT_RAY_READER_H_
