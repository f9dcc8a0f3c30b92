// Build statistics as text for people.

#ifndef CLIENT_STATS_TEXT_H_
#define CLIENT_STATS_TEXT_H_

#include <string>

#include "deltaray/v1/mesh.pb.h"

namespace deltaray {

// The statistics of a build, one group of facts a line, then its phases and the sizes of its δ-leaves.
std::string BuildStatsText(const std::string& mesh_id, const v1::BuildStats& stats);

}  // namespace deltaray

#endif  // CLIENT_STATS_TEXT_H_
