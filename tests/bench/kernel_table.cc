#include "tests/bench/kernel_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace deltaray {
namespace {

// A column of the summary: our level against Embree's.
struct Comparison {
  std::string_view title, ours, theirs;
};
constexpr std::array<Comparison, 4> kComparisons = {{{"fast/HIGH", "fast", "fast"},
                                                     {"watertight/HIGH", "watertight", "fast"},
                                                     {"exact/HIGH", "exact", "fast"},
                                                     {"watertight/ROBUST", "watertight", "robust"}}};

std::optional<double> Ratio(std::optional<double> a, std::optional<double> b) {
  if (!a || !b || *b == 0) return std::nullopt;
  return *a / *b;
}

std::string Cell(std::optional<double> value) {
  return value ? absl::StrFormat("%18.2f", *value) : absl::StrFormat("%18s", "-");
}

// The values of a sequence, each once, in order.
template <typename Value, typename Get>
std::vector<Value> Distinct(const std::vector<KernelRow>& rows, Get get) {
  std::vector<Value> values;
  for (const KernelRow& row : rows) {
    if (std::find(values.begin(), values.end(), get(row)) == values.end()) values.push_back(get(row));
  }
  return values;
}

// One block of the summary: a line for each scene and set of rays, then mean and minimum of each column.
class Block {
 public:
  explicit Block(const std::string& title) {
    std::string line = absl::StrFormat("%-24s", title);
    for (const Comparison& comparison : kComparisons) {
      absl::StrAppendFormat(&line, "%18s", std::string(comparison.title));
    }
    lines_.push_back(std::move(line));
  }

  void Add(const std::string& name, const std::array<std::optional<double>, kComparisons.size()>& ratios) {
    if (std::none_of(ratios.begin(), ratios.end(), [](const auto& ratio) { return ratio.has_value(); })) return;
    std::string line = absl::StrFormat("%-24s", name);
    for (size_t i = 0; i < ratios.size(); ++i) {
      absl::StrAppend(&line, Cell(ratios[i]));
      if (ratios[i]) columns_[i].push_back(*ratios[i]);
    }
    lines_.push_back(std::move(line));
  }

  // Nothing where nothing was added.
  std::vector<std::string> Finish() {
    if (lines_.size() == 1) return {};
    std::string mean = absl::StrFormat("%-24s", "geometric mean");
    std::string minimum = absl::StrFormat("%-24s", "minimum");
    for (const std::vector<double>& column : columns_) {
      absl::StrAppend(&mean, Cell(GeometricMean(column)));
      absl::StrAppend(&minimum, Cell(column.empty() ? std::nullopt
                                                    : std::optional(*std::min_element(column.begin(), column.end()))));
    }
    lines_.push_back(std::move(mean));
    lines_.push_back(std::move(minimum));
    return std::move(lines_);
  }

 private:
  std::vector<std::string> lines_;
  std::array<std::vector<double>, kComparisons.size()> columns_;
};

}  // namespace

std::string ToCsv(const KernelRow& row) {
  return absl::StrFormat("%s,%s,%s,%s,%s,%d,%.3f,%.3f", row.scene, row.rays, row.engine, row.mode, row.level,
                         row.threads, row.mrays_s, row.spread);
}

std::optional<double> KernelTable::Best(std::string_view scene, std::string_view rays, std::string_view engine,
                                        std::initializer_list<std::string_view> modes, std::string_view level,
                                        uint32_t threads) const {
  std::optional<double> best;
  for (const KernelRow& row : rows_) {
    if (row.scene == scene && row.rays == rays && row.engine == engine && row.level == level &&
        row.threads == threads && std::find(modes.begin(), modes.end(), row.mode) != modes.end()) {
      best = std::max(best.value_or(0), row.mrays_s);
    }
  }
  return best;
}

std::vector<std::string> KernelTable::Summary() const {
  const auto scenes = Distinct<std::string>(rows_, [](const KernelRow& row) { return row.scene; });
  const auto sets = Distinct<std::string>(rows_, [](const KernelRow& row) { return row.rays; });
  std::vector<std::string> lines;
  for (const uint32_t threads : Distinct<uint32_t>(rows_, [](const KernelRow& row) { return row.threads; })) {
    Block others(absl::StrCat("auto / single or 1M, ", threads));
    Block cameras(absl::StrCat("auto / packets, ", threads));
    for (const std::string& scene : scenes) {
      for (const std::string& rays : sets) {
        const bool camera = rays == "camera";
        std::array<std::optional<double>, kComparisons.size()> ratios;
        for (size_t i = 0; i < ratios.size(); ++i) {
          const auto& [title, ours, theirs] = kComparisons[i];
          const auto peer = camera ? Best(scene, rays, "embree", {"16", "8"}, theirs, threads)
                                   : Best(scene, rays, "embree", {"single", "1M"}, theirs, threads);
          ratios[i] = Ratio(Best(scene, rays, "deltaray", {"auto"}, ours, threads), peer);
        }
        (camera ? cameras : others).Add(absl::StrCat(scene, " ", rays), ratios);
      }
    }
    for (Block* const block : {&others, &cameras}) {
      for (std::string& line : block->Finish()) lines.push_back(std::move(line));
    }
  }
  return lines;
}

std::optional<double> GeometricMean(const std::vector<double>& values) {
  if (values.empty()) return std::nullopt;
  double sum = 0;
  for (const double value : values) sum += std::log(value);
  return std::exp(sum / static_cast<double>(values.size()));
}

}  // namespace deltaray
