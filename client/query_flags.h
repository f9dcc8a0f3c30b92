// The options that say what to ask of every ray; `cast` and `render` share them.

#ifndef CLIENT_QUERY_FLAGS_H_
#define CLIENT_QUERY_FLAGS_H_

#include <cstddef>

#include "CLI/App.hpp"
#include "deltaray/v1/ray_service.pb.h"

namespace deltaray {

// Rays a batch where --batch is not given: where throughput levels off, with little memory held.
constexpr size_t kDefaultBatchRays = 16384;

// Adds --accuracy, --cull, --t-min, --t-max and --wait-final, which set their fields of `query`, and --batch.
void AddQueryFlags(CLI::App& command, v1::RayQuery& query, size_t& batch_rays);

}  // namespace deltaray

#endif  // CLIENT_QUERY_FLAGS_H_
