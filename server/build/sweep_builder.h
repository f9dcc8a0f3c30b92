// The top-down candidate for a δ-leaf.

#ifndef SERVER_BUILD_SWEEP_BUILDER_H_
#define SERVER_BUILD_SWEEP_BUILDER_H_

#include <span>

#include "server/build/build_context.h"
#include "server/build/clustering.h"
#include "server/build/reference.h"
#include "server/build/sah.h"

namespace deltaray {

// Splits `references` down to single ones, each time by the cheapest of all object splits: those before and after each
// centre along each axis. From depth kSahDepth on, in halves. Polls `context` at every split and returns anything once
// it is cancelled. REQUIRES: references is not empty.
Dendrogram SplitBySweeps(std::span<const Reference> references, const SahCosts& costs, const BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_SWEEP_BUILDER_H_
