#include "client/accuracy_chart.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "client/accuracy_text.h"
#include "client/text_table.h"

namespace deltaray {
namespace {

constexpr double kWidth = 960;
constexpr double kHeight = 576;
// What of a wide font fits beside each other.
constexpr size_t kFooterLetters = 125;
// The plot.
constexpr double kLeft = 90;
constexpr double kRight = 920;
constexpr double kTop = 60;
constexpr double kBottom = 360;
// The line of no wrong answers: a little above the bottom, which it is not to be taken for.
constexpr double kZeroLine = kBottom - 16;
// Of FAST, WATERTIGHT and EXACT: told apart by those who see no red and green too.
constexpr std::array kColours = {"#d55e00", "#0072b2", "#009e73"};
constexpr const char* kGrey = "#606060";

std::string Escaped(const std::string& text) {
  return absl::StrReplaceAll(Printable(text), {{"&", "&amp;"}, {"<", "&lt;"}, {">", "&gt;"}, {"\"", "&quot;"}});
}

std::string Text(double x, double y, const char* anchor, const char* colour, const std::string& text) {
  return absl::StrFormat("<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" fill=\"%s\">%s</text>\n", x, y, anchor, colour,
                         Escaped(text));
}

std::string Line(double x1, double y1, double x2, double y2, const char* colour) {
  return absl::StrFormat("<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\"/>\n", x1, y1, x2, y2,
                         colour);
}

// 1, 2 or 5 times a power of ten: the step of at most eight ticks from 0 to `most`.
double Step(double most) {
  const double decade = std::pow(10, std::floor(std::log10(most / 8)));
  for (const double step : {1.0, 2.0, 5.0}) {
    if (most / (step * decade) <= 8) return step * decade;
  }
  return 10 * decade;
}

// Where things stand in the plot.
class Scales {
 public:
  explicit Scales(const v1::CompareAccuracyResponse& comparison) {
    double slowest = 0;
    for (const v1::AccuracyMeasurement& level : comparison.levels()) {
      slowest = std::max(slowest, level.nanoseconds_per_ray());
      const double wrong = WrongPerMillion(level, comparison.ray_count());
      if (wrong == 0) continue;
      const int decade = static_cast<int>(std::floor(std::log10(wrong)));
      first_decade_ = any_ ? std::min(first_decade_, decade) : decade;
      last_decade_ = any_ ? std::max(last_decade_, decade + 1) : decade + 1;
      any_ = true;
    }
    step_ = Step(std::max(slowest, 1e-3));
    most_ = step_ * std::ceil(1.15 * slowest / step_);
  }

  double X(double nanoseconds) const { return kLeft + (kRight - kLeft) * nanoseconds / std::max(most_, step_); }
  double Y(double wrong) const {
    if (wrong == 0) return kZeroLine;
    // The first decade's line is one decade above that of none.
    const double decades = last_decade_ - first_decade_ + 1;
    return kZeroLine - (kZeroLine - kTop) * (std::log10(wrong) - first_decade_ + 1) / decades;
  }

  std::string Axes() const {
    std::string svg;
    for (int i = 0; i * step_ <= most_ * 1.001; ++i) {
      svg += Line(X(i * step_), kTop, X(i * step_), kBottom, "#e8e8e8");
      svg += Text(X(i * step_), kBottom + 18, "middle", kGrey, absl::StrFormat("%g", i * step_));
    }
    svg += Line(kLeft, kZeroLine, kRight, kZeroLine, "#c0c0c0") + Text(kLeft - 8, kZeroLine + 4, "end", kGrey, "0");
    for (int decade = first_decade_; decade <= last_decade_; ++decade) {
      const double wrong = std::pow(10, decade);
      svg += Line(kLeft, Y(wrong), kRight, Y(wrong), "#e8e8e8");
      svg += Text(kLeft - 8, Y(wrong) + 4, "end", kGrey, absl::StrFormat("%.10g", wrong));
    }
    svg += Line(kLeft, kTop, kLeft, kBottom, kGrey) + Line(kLeft, kBottom, kRight, kBottom, kGrey);
    svg += Text((kLeft + kRight) / 2, kBottom + 38, "middle", kGrey, "nanoseconds a ray, of one thread");
    absl::StrAppend(&svg, "<g transform=\"rotate(-90)\">\n",
                    Text(-(kTop + kBottom) / 2, 24, "middle", kGrey, "wrong answers per million rays"), "</g>\n");
    return svg;
  }

 private:
  bool any_ = false;
  int first_decade_ = 0;
  int last_decade_ = 1;
  double step_ = 1;
  double most_ = 0;
};

std::string Points(const Scales& scales, const v1::CompareAccuracyResponse& comparison,
                   const std::vector<std::vector<std::string>>& rows) {
  std::string svg;
  for (int i = 0; i < comparison.levels_size(); ++i) {
    const v1::AccuracyMeasurement& level = comparison.levels(i);
    const double x = scales.X(level.nanoseconds_per_ray());
    const double y = scales.Y(WrongPerMillion(level, comparison.ray_count()));
    const char* const colour = kColours[i % kColours.size()];
    absl::StrAppendFormat(&svg, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"6\" fill=\"%s\"/>\n", x, y, colour);
    // Each level has a height of its own above its point, so that labels of points that lie close do not cover each
    // other.
    svg += Text(std::clamp(x, kLeft + 70, kRight - 70), y - 12 - 16 * i, "middle", colour,
                absl::StrCat(rows[i + 1][0], ": ", rows[i + 1][1], " ns"));
  }
  return svg;
}

std::string Table(const std::vector<std::vector<std::string>>& rows) {
  constexpr std::array kColumnEnds = {0.0, 200.0, 262.0, 378.0, 468.0, 540.0, 655.0, 752.0, 838.0, 938.0};
  std::string svg;
  for (size_t row = 0; row < rows.size(); ++row) {
    const double y = kBottom + 76 + 20 * static_cast<double>(row);
    const char* const colour = row == 0 ? kGrey : kColours[(row - 1) % kColours.size()];
    svg += Text(24, y, "start", colour, rows[row][0]);
    for (size_t i = 1; i < kColumnEnds.size(); ++i) svg += Text(kColumnEnds[i], y, "end", colour, rows[row][i]);
  }
  return svg;
}

// The text in lines of kFooterLetters at most, split at blanks; a word that is longer keeps a line to itself.
std::vector<std::string> Lines(const std::string& text) {
  std::vector<std::string> lines;
  for (const absl::string_view word : absl::StrSplit(text, ' ')) {
    if (lines.empty() || lines.back().size() + 1 + word.size() > kFooterLetters) {
      lines.emplace_back(word);
    } else {
      absl::StrAppend(&lines.back(), " ", word);
    }
  }
  return lines;
}

}  // namespace

std::string AccuracyChartSvg(const std::string& title, const std::string& footer,
                             const v1::CompareAccuracyResponse& comparison) {
  const std::vector<std::vector<std::string>> rows = AccuracyRows(comparison);
  const Scales scales(comparison);
  std::string svg = absl::StrFormat(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%g\" height=\"%g\" viewBox=\"0 0 %g %g\" "
      "font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%%\" height=\"100%%\" fill=\"white\"/>\n",
      kWidth, kHeight, kWidth, kHeight);
  absl::StrAppend(&svg, Text(24, 30, "start", "#202020", title), scales.Axes(), Points(scales, comparison, rows),
                  Table(rows));
  double y = kHeight - 60;
  svg += Text(24, y, "start", kGrey, absl::StrCat("memory: ", MemoryText(comparison)));
  y += 22;
  for (const std::string& line : Lines(footer)) {
    svg += Text(24, y, "start", "#202020", line);
    y += 18;
  }
  return absl::StrCat(svg, "</svg>\n");
}

}  // namespace deltaray
