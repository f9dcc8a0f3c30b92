// Small text files of `key=value` lines with a checksum: names and build configs.
//
//   deltaray name 1
//   mesh=0123…
//   name=bunny
//   sha256=<SHA-256 of all that stands above, 64 hexadecimal digits>
//
// Keys stand in a fixed order. No value holds a line feed.

#ifndef SERVER_STORE_RECORD_FILE_H_
#define SERVER_STORE_RECORD_FILE_H_

#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/build/config.h"

namespace deltaray {

// No record file is larger.
inline constexpr uint64_t kMaxRecordBytes = 4096;

std::string EncodeConfig(const Config& config);
// DATA_LOSS where `text` is not whole or not valid; FAILED_PRECONDITION where a newer deltaray wrote it.
absl::StatusOr<Config> DecodeConfig(absl::string_view text);

struct NameRecord {
  std::string name;
  std::string id;  // of the mesh
};
std::string EncodeName(const NameRecord& record);
// As DecodeConfig.
absl::StatusOr<NameRecord> DecodeName(absl::string_view text);

}  // namespace deltaray

#endif  // SERVER_STORE_RECORD_FILE_H_
