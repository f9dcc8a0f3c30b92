#include "server/store/record_file.h"

#include <iterator>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "server/store/mesh_name.h"
#include "server/store/mesh_store.h"
#include "server/store/sha256.h"

namespace deltaray {
namespace {

constexpr absl::string_view kConfigKind = "deltaray build config ";
constexpr absl::string_view kNameKind = "deltaray name ";
constexpr absl::string_view kRecordVersion = "1";

constexpr absl::string_view kPresets[] = {"fast", "balanced", "best", "auto"};
constexpr absl::string_view kBuilders[] = {"hybrid", "kd_tree", "bvh", "sbvh", "tang2015"};

class RecordWriter {
 public:
  explicit RecordWriter(absl::string_view kind) : text_(absl::StrCat(kind, kRecordVersion, "\n")) {}

  void Add(absl::string_view key, absl::string_view value) { absl::StrAppend(&text_, key, "=", value, "\n"); }
  void Add(absl::string_view key, uint32_t value) { Add(key, absl::StrCat(value)); }
  // 17 digits give the same double back.
  void Add(absl::string_view key, double value) { Add(key, absl::StrFormat("%.17g", value)); }

  std::string Finish() {
    Add("sha256", Sha256::Hex(text_));
    return std::move(text_);
  }

 private:
  std::string text_;
};

// Takes the values out in the order in which they were added. The first error stays.
class RecordReader {
 public:
  RecordReader(absl::string_view text, absl::string_view kind) : rest_(text) {
    const absl::string_view first_line = TakeLine();
    absl::string_view version = first_line;
    if (!absl::ConsumePrefix(&version, kind)) {
      status_ = absl::DataLossError("not a record of this kind");
    } else if (version != kRecordVersion) {
      uint32_t number = 0;
      status_ = absl::SimpleAtoi(version, &number) && number > 1
                    ? absl::FailedPreconditionError(
                          absl::StrCat("of format version ", number, "; this deltaray reads version ", kRecordVersion))
                    : absl::DataLossError("malformed first line");
    }
    if (!status_.ok()) return;
    const size_t last_line = text.rfind("sha256=");
    if (last_line == absl::string_view::npos ||
        text.substr(last_line) != absl::StrCat("sha256=", Sha256::Hex(text.substr(0, last_line)), "\n")) {
      status_ = absl::DataLossError("truncated, or its checksum is wrong");
      return;
    }
    rest_.remove_suffix(text.size() - last_line);
  }

  absl::string_view Take(absl::string_view key) {
    absl::string_view line = TakeLine();
    if (!absl::ConsumePrefix(&line, key) || !absl::ConsumePrefix(&line, "=")) {
      Fail(key);
      return {};
    }
    return line;
  }

  template <typename Enum, size_t n>
  void Take(absl::string_view key, const absl::string_view (&names)[n], Enum* value) {
    const absl::string_view text = Take(key);
    for (size_t i = 0; i < n; ++i) {
      if (text == names[i]) {
        *value = static_cast<Enum>(i);
        return;
      }
    }
    Fail(key);
  }
  void Take(absl::string_view key, uint32_t* value) {
    if (!absl::SimpleAtoi(Take(key), value)) Fail(key);
  }
  void Take(absl::string_view key, double* value) {
    if (!absl::SimpleAtod(Take(key), value)) Fail(key);
  }
  void Take(absl::string_view key, bool* value) {
    uint32_t number = 0;
    Take(key, &number);
    if (number > 1) Fail(key);
    *value = number == 1;
  }

  absl::Status Finish() {
    if (status_.ok() && !rest_.empty()) status_ = absl::DataLossError("has more lines than it should");
    return status_;
  }

 private:
  absl::string_view TakeLine() {
    const size_t end = rest_.find('\n');
    const absl::string_view line = rest_.substr(0, end);
    rest_.remove_prefix(end == absl::string_view::npos ? rest_.size() : end + 1);
    return line;
  }
  void Fail(absl::string_view key) {
    if (status_.ok()) status_ = absl::DataLossError(absl::StrCat("no valid ", key));
  }

  absl::string_view rest_;
  absl::Status status_;
};

}  // namespace

std::string EncodeConfig(const Config& config) {
  RecordWriter writer(kConfigKind);
  writer.Add("preset", kPresets[static_cast<size_t>(config.preset)]);
  writer.Add("builder", kBuilders[static_cast<size_t>(config.builder)]);
  writer.Add("delta", config.delta);
  writer.Add("alpha", config.alpha);
  writer.Add("cluster_traversal_cost", config.cluster_traversal_cost);
  writer.Add("cluster_intersection_cost", config.cluster_intersection_cost);
  writer.Add("traversal_cost", config.traversal_cost);
  writer.Add("intersection_cost", config.intersection_cost);
  writer.Add("max_leaf_size", config.max_leaf_size);
  writer.Add("spatial_split_gate", config.spatial_split_gate);
  writer.Add("duplication_budget", config.duplication_budget);
  writer.Add("lazy", uint32_t{config.lazy});
  return writer.Finish();
}

absl::StatusOr<Config> DecodeConfig(absl::string_view text) {
  Config config;
  RecordReader reader(text, kConfigKind);
  reader.Take("preset", kPresets, &config.preset);
  reader.Take("builder", kBuilders, &config.builder);
  reader.Take("delta", &config.delta);
  reader.Take("alpha", &config.alpha);
  reader.Take("cluster_traversal_cost", &config.cluster_traversal_cost);
  reader.Take("cluster_intersection_cost", &config.cluster_intersection_cost);
  reader.Take("traversal_cost", &config.traversal_cost);
  reader.Take("intersection_cost", &config.intersection_cost);
  reader.Take("max_leaf_size", &config.max_leaf_size);
  reader.Take("spatial_split_gate", &config.spatial_split_gate);
  reader.Take("duplication_budget", &config.duplication_budget);
  reader.Take("lazy", &config.lazy);
  if (absl::Status status = reader.Finish(); !status.ok()) return status;
  if (absl::Status status = Validate(config); !status.ok()) return absl::DataLossError(status.message());
  return config;
}

std::string EncodeName(const NameRecord& record) {
  RecordWriter writer(kNameKind);
  writer.Add("mesh", record.id);
  writer.Add("name", record.name);
  return writer.Finish();
}

absl::StatusOr<NameRecord> DecodeName(absl::string_view text) {
  NameRecord record;
  RecordReader reader(text, kNameKind);
  record.id = std::string(reader.Take("mesh"));
  record.name = std::string(reader.Take("name"));
  if (absl::Status status = reader.Finish(); !status.ok()) return status;
  if (absl::Status status = ValidateMeshName(record.name); !status.ok()) return absl::DataLossError(status.message());
  if (!IsMeshId(record.id)) return absl::DataLossError("mesh is not a mesh id");
  return record;
}

}  // namespace deltaray
