// References in an order in which neighbours in space stand near each other.

#ifndef SERVER_BUILD_MORTON_ORDER_H_
#define SERVER_BUILD_MORTON_ORDER_H_

#include <cstdint>
#include <span>
#include <vector>

#include "server/build/build_context.h"
#include "server/build/reference.h"

namespace deltaray {

// The places in `references` in the order of their centres along a Morton curve [Morton 1966] through 2048³ cubes; in
// one cube, in the order given. In parallel, in time proportional to the references, with 16 bytes for each of them
// besides the result. The same for any number of threads. Anything where the build is cancelled; throws std::bad_alloc.
// REQUIRES: references.size() < 2^31.
std::vector<uint32_t> MortonOrder(std::span<const Reference> references, BuildContext& context);

}  // namespace deltaray

#endif  // SERVER_BUILD_MORTON_ORDER_H_
