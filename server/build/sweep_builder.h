// The top-down candidate for a δ-leaf.

#ifndef SERVER_BUILD_SWEEP_BUILDER_H_
#define SERVER_BUILD_SWEEP_BUILDER_H_

#include <span>

#include "server/build/build_context.h"
#include "server/build/clustering.h"
#include "server/build/reference.h"

namespace deltaray {

// Splits `references` down to single ones, each time by the cheapest of all object splits, up to depth kSahDepth;
// below, in halves. Polls `context` at every split and returns anything once it is cancelled.
Dendrogram SplitBySweeps(std::span<const Reference> references, const BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_SWEEP_BUILDER_H_
