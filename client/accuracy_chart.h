// A chart of speed against accuracy, as an SVG.

#ifndef CLIENT_ACCURACY_CHART_H_
#define CLIENT_ACCURACY_CHART_H_

#include <string>

#include "deltaray/v1/ray_service.pb.h"

namespace deltaray {

// Wrong answers per million rays, on a scale of decades with a line for none below them, over nanoseconds a ray: a
// point a level, and a table of the rest under it. `title` is any text; `footer` stands in the last line.
std::string AccuracyChartSvg(const std::string& title, const std::string& footer,
                             const v1::CompareAccuracyResponse& comparison);

}  // namespace deltaray

#endif  // CLIENT_ACCURACY_CHART_H_
