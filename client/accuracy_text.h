// What accuracy levels cost and how often they are wrong, as text and as a choice.

#ifndef CLIENT_ACCURACY_TEXT_H_
#define CLIENT_ACCURACY_TEXT_H_

#include <cstdint>
#include <string>
#include <vector>

#include "deltaray/v1/ray_service.pb.h"

namespace deltaray {

// Wrong answers in a million rays. REQUIRES: rays > 0.
double WrongPerMillion(const v1::AccuracyMeasurement& level, uint64_t rays);

// The level of least time among those that are wrong at most so often; null where there is none, which a server that
// keeps the contract leaves no room for: EXACT is never wrong.
const v1::AccuracyMeasurement* CheapestLevel(const v1::CompareAccuracyResponse& comparison,
                                             double max_wrong_per_million);

// "cheapest level with at most 50 wrong answers per million: watertight (4 wrong of 100,000 rays)". Where none was
// wrong, it tells how many in a million may be all the same.
std::string CheapestLevelText(const v1::CompareAccuracyResponse& comparison, double max_wrong_per_million);

// Cells of the table for people, a row a level, the first row its heads; and what the memory is.
std::vector<std::vector<std::string>> AccuracyRows(const v1::CompareAccuracyResponse& comparison);
std::string MemoryText(const v1::CompareAccuracyResponse& comparison);

// The whole table for people, without the choice.
std::string AccuracyText(const v1::CompareAccuracyResponse& comparison);

// CSV with a header and a row a level: how many rays were traced and hit, and the fields of AccuracyMeasurement.
std::string AccuracyCsv(const v1::CompareAccuracyResponse& comparison);

}  // namespace deltaray

#endif  // CLIENT_ACCURACY_TEXT_H_
