// The options that say what to ask of every ray; `cast`, `render` and `chart` share them.

#ifndef CLIENT_QUERY_FLAGS_H_
#define CLIENT_QUERY_FLAGS_H_

#include <cstddef>
#include <optional>

#include "CLI/App.hpp"
#include "absl/status/status.h"
#include "deltaray/v1/ray_service.pb.h"

namespace deltaray {

// The contract's limit of rays a batch.
constexpr size_t kMaxBatchRays = 1 << 20;

// Most of --batch: with ids to exclude, so many rays of 64 bytes fit in the 64 MiB of a message.
constexpr size_t kMaxStreamedBatchRays = 980'000;

// Rays a batch where --batch is not given: where throughput levels off, with little memory held.
constexpr size_t kDefaultBatchRays = 16384;

// Adds --cull, --t-min and --t-max, which set their fields of `query`.
void AddRayFlags(CLI::App& command, v1::RayQuery& query);

// A UsageError where --t-min or --t-max is given and the rays of query.layout() have intervals of their own.
absl::Status CheckInterval(const v1::RayQuery& query);

// Adds --rays-format, which sets `layout`; nullopt, the default, is CSV.
void AddRaysFormatFlag(CLI::App& command, std::optional<v1::RayLayout>& layout);

// Adds the flags of AddRayFlags, and --accuracy and --wait-final, which set their fields of `query`, and --batch.
void AddQueryFlags(CLI::App& command, v1::RayQuery& query, size_t& batch_rays);

}  // namespace deltaray

#endif  // CLIENT_QUERY_FLAGS_H_
