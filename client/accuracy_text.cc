#include "client/accuracy_text.h"

#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/enum_names.h"
#include "client/message_text.h"
#include "client/text_table.h"

namespace deltaray {

namespace {

uint64_t WrongAnswers(const v1::AccuracyMeasurement& level) {
  return level.false_misses() + level.false_hits() + level.wrong_primitives();
}

// How much the measurement says of a level.
std::string EvidenceText(const v1::AccuracyMeasurement& level, uint64_t rays) {
  if (level.answered_accuracy() == v1::ACCURACY_LEVEL_EXACT) return "never wrong: the others are measured by it";
  const std::string of_rays = absl::StrCat(" of ", GroupDigits(rays), " rays");
  if (const uint64_t wrong = WrongAnswers(level); wrong > 0) return absl::StrCat(GroupDigits(wrong), " wrong", of_rays);
  // The rule of three: what happens with a probability of 3 / n happens at least once in n times, with a probability of
  // 1 - e^-3 and more.
  const double bound = 3e6 / static_cast<double>(rays);
  const std::string none = absl::StrCat("none wrong", of_rays);
  if (bound >= 1e6) return absl::StrCat(none, ", which are too few to show anything");
  const std::string at_most =
      bound < 10 ? absl::StrFormat("%.1f", std::ceil(bound * 10) / 10) : GroupDigits(std::ceil(bound));
  return absl::StrCat(none, ", which shows fewer than ", at_most, " per million with 95 % confidence");
}

}  // namespace

double WrongPerMillion(const v1::AccuracyMeasurement& level, uint64_t rays) {
  return 1e6 * static_cast<double>(WrongAnswers(level)) / static_cast<double>(rays);
}

const v1::AccuracyMeasurement* CheapestLevel(const v1::CompareAccuracyResponse& comparison,
                                             double max_wrong_per_million) {
  const v1::AccuracyMeasurement* cheapest = nullptr;
  for (const v1::AccuracyMeasurement& level : comparison.levels()) {
    if (WrongPerMillion(level, comparison.ray_count()) > max_wrong_per_million) continue;
    if (cheapest == nullptr || level.nanoseconds_per_ray() < cheapest->nanoseconds_per_ray()) cheapest = &level;
  }
  return cheapest;
}

std::string CheapestLevelText(const v1::CompareAccuracyResponse& comparison, double max_wrong_per_million) {
  const v1::AccuracyMeasurement* const level = CheapestLevel(comparison, max_wrong_per_million);
  const std::string text =
      absl::StrCat("cheapest level with at most ", max_wrong_per_million, " wrong answers per million: ");
  if (level == nullptr) return absl::StrCat(text, "none");
  return absl::StrCat(text, EnumName(level->accuracy()), " (", EvidenceText(*level, comparison.ray_count()), ")");
}

std::vector<std::vector<std::string>> AccuracyRows(const v1::CompareAccuracyResponse& comparison) {
  std::vector<std::vector<std::string>> rows = {{"level", "ns a ray", "Mrays/s", "wrong per million", "false misses",
                                                 "false hits", "wrong primitives", "t error 99.9 %", "t error max",
                                                 "u, v error max"}};
  for (const v1::AccuracyMeasurement& level : comparison.levels()) {
    std::string name = EnumName(level.accuracy());
    if (level.answered_accuracy() != level.accuracy()) {
      absl::StrAppend(&name, " (as ", EnumName(level.answered_accuracy()), ")");
    }
    rows.push_back({name, absl::StrFormat("%.1f", level.nanoseconds_per_ray()),
                    absl::StrFormat("%.2f", 1e3 / level.nanoseconds_per_ray()),
                    absl::StrFormat("%.6g", WrongPerMillion(level, comparison.ray_count())),
                    GroupDigits(level.false_misses()), GroupDigits(level.false_hits()),
                    GroupDigits(level.wrong_primitives()), absl::StrCat(GroupDigits(level.t_error_ulp_p999()), " ulp"),
                    absl::StrCat(GroupDigits(level.t_error_ulp_max()), " ulp"),
                    absl::StrFormat("%.2g", level.uv_error_max())});
  }
  return rows;
}

std::string MemoryText(const v1::CompareAccuracyResponse& comparison) {
  return absl::StrCat("nodes ", BytesText(comparison.node_bytes()), ", references ",
                      BytesText(comparison.reference_bytes()), ", mesh ", BytesText(comparison.mesh_bytes()));
}

std::string AccuracyText(const v1::CompareAccuracyResponse& comparison) {
  TextTable facts({Align::kLeft, Align::kLeft});
  facts.Add({"mesh", comparison.mesh_id()});
  facts.Add({"rays", absl::StrCat(GroupDigits(comparison.ray_count()), ", of which ",
                                  GroupDigits(comparison.hit_count()), " hit")});
  facts.Add({"memory", MemoryText(comparison)});
  TextTable levels({Align::kLeft, Align::kRight, Align::kRight, Align::kRight, Align::kRight, Align::kRight,
                    Align::kRight, Align::kRight, Align::kRight, Align::kRight});
  for (std::vector<std::string>& row : AccuracyRows(comparison)) levels.Add(std::move(row));
  return absl::StrCat(facts.Render(), "\n", levels.Render());
}

std::string AccuracyCsv(const v1::CompareAccuracyResponse& comparison) {
  std::string csv = absl::StrCat("ray_count,hit_count,", CsvHeader(v1::AccuracyMeasurement()));
  const std::string rays = absl::StrCat(comparison.ray_count(), ",", comparison.hit_count(), ",");
  for (const v1::AccuracyMeasurement& level : comparison.levels()) absl::StrAppend(&csv, rays, CsvRow(level));
  return csv;
}

}  // namespace deltaray
