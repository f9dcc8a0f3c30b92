// The memory of a build of a stored mesh.

#ifndef SERVER_STORE_BUILD_MEMORY_H_
#define SERVER_STORE_BUILD_MEMORY_H_

#include <functional>
#include <memory>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/store/mesh_store.h"
#include "server/store/tree_budget.h"

namespace deltaray {

// RESOURCE_EXHAUSTED where `budget` could never hold a build of the mesh.
absl::Status CheckBuildFits(const MeshInfo& info, const Config& config, const TreeBudget& budget);

// TreeBudget::Reserve of what the build may take at its peak, its mesh included.
absl::StatusOr<std::shared_ptr<TreeBudget::Reservation>> ReserveForBuild(const MeshInfo& info, const Config& config,
                                                                         TreeBudget* budget,
                                                                         const std::function<bool()>& cancelled);

}  // namespace deltaray

#endif  // SERVER_STORE_BUILD_MEMORY_H_
