#include "client/stats_text.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/enum_names.h"
#include "client/mesh_text.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

std::string ReferencesText(const v1::BuildStats& stats) {
  std::string text = GroupDigits(stats.references());
  if (stats.triangles() > 0) {
    absl::StrAppendFormat(&text, " (%.3f a triangle)", static_cast<double>(stats.references()) / stats.triangles());
  }
  return text;
}

// A moment of the build; 0 is one that has not come yet.
std::string MomentText(double seconds) { return seconds > 0 ? SecondsText(seconds) : "-"; }

std::string PhasesText(const v1::BuildStats& stats) {
  TextTable table({Align::kLeft, Align::kRight, Align::kRight});
  table.Add({"phase", "wall", "CPU"});
  for (const v1::PhaseTime& phase : stats.phases()) {
    table.Add({EnumName(phase.phase()), SecondsText(phase.wall_seconds()), SecondsText(phase.cpu_seconds())});
  }
  return table.Render();
}

std::string LeafSizesText(const v1::BuildStats& stats) {
  TextTable table({Align::kRight, Align::kRight});
  table.Add({"references", "δ-leaves"});
  for (int i = 0; i < stats.delta_leaf_size_histogram_size(); ++i) {
    const uint64_t low = uint64_t{1} << i;
    table.Add({i == 0 ? "1" : absl::StrCat(low, "-", 2 * low - 1), GroupDigits(stats.delta_leaf_size_histogram(i))});
  }
  return table.Render();
}

}  // namespace

std::string BuildStatsText(const std::string& mesh_id, const v1::BuildStats& stats) {
  const v1::CandidateWins& wins = stats.candidate_wins();
  TextTable table({Align::kLeft, Align::kLeft});
  table.Add({"mesh", mesh_id});
  table.Add({"build", absl::StrCat(stats.build_number(), ": ", BuildOptionsText(stats.options()), ", ", stats.threads(),
                                   " threads")});
  table.Add({"triangles", GroupDigits(stats.triangles())});
  table.Add({"references", ReferencesText(stats)});
  table.Add(
      {"splits", absl::StrCat("spatial ", GroupDigits(stats.spatial_splits()), ", object ",
                              GroupDigits(stats.object_splits()), ", median ", GroupDigits(stats.median_splits()))});
  table.Add({"δ-leaves",
             absl::StrCat(GroupDigits(stats.delta_leaves_built()), " built of ", GroupDigits(stats.delta_leaves()))});
  table.Add(
      {"candidates won", absl::StrCat("combined cost ", GroupDigits(wins.combined_cost()), ", area only ",
                                      GroupDigits(wins.area_only()), ", distance only ",
                                      GroupDigits(wins.distance_only()), ", top-down ", GroupDigits(wins.top_down()))});
  table.Add({"tree", absl::StrCat(GroupDigits(stats.nodes()), " nodes, ", GroupDigits(stats.leaves()),
                                  " leaves, depth ", stats.max_depth())});
  table.Add({"SAH cost", absl::StrFormat("%.3f", stats.sah_cost())});
  table.Add({"memory", absl::StrCat("nodes ", BytesText(stats.node_bytes()), ", references ",
                                    BytesText(stats.reference_bytes()), ", mesh ", BytesText(stats.mesh_bytes()),
                                    ", peak of the build ", BytesText(stats.peak_build_bytes()))});
  table.Add({"rays after", absl::StrCat(MomentText(stats.provisional_seconds()), ", first answered after ",
                                        MomentText(stats.first_answer_seconds()))});
  table.Add({"final after", MomentText(stats.total_seconds())});
  for (int i = 0; i < stats.choices_size(); ++i) table.Add({i == 0 ? "chosen" : "", stats.choices(i)});
  std::string text = table.Render();
  if (stats.phases_size() > 0) absl::StrAppend(&text, "\n", PhasesText(stats));
  if (stats.delta_leaf_size_histogram_size() > 0) absl::StrAppend(&text, "\n", LeafSizesText(stats));
  return text;
}

}  // namespace deltaray
