#include "server/build/run_build.h"

#include <utility>

#include "server/build/reference.h"
#include "server/build/top_down.h"
#include "server/tree/bvh.h"

namespace deltaray {
namespace {

// A tree that keeps its mesh alive.
template <typename T, typename... Arguments>
std::shared_ptr<T> MakeTree(std::shared_ptr<const TriangleMesh> mesh, Arguments&&... arguments) {
  struct Owner {
    Owner(std::shared_ptr<const TriangleMesh> mesh, Arguments&&... arguments)
        : mesh(std::move(mesh)), tree(this->mesh->triangles(), std::forward<Arguments>(arguments)...) {}
    std::shared_ptr<const TriangleMesh> mesh;
    T tree;
  };
  auto owner = std::make_shared<Owner>(std::move(mesh), std::forward<Arguments>(arguments)...);
  return std::shared_ptr<T>(owner, &owner->tree);
}

}  // namespace

absl::StatusOr<std::shared_ptr<const Tree>> RunBuild(
    const std::shared_ptr<const TriangleMesh>& mesh, const Build::Options& options,
    const std::shared_ptr<BuildContext>& context,
    const std::function<void(std::shared_ptr<const Tree>)>& publish_provisional) {
  context->EnterPhase(BuildPhase::kReferences);
  absl::StatusOr<ReferenceArray> references = [&] {
    const BuildContext::CpuTime time(*context);
    return MakeReferences(mesh->triangles(), options.config.duplication_budget, *context);
  }();
  if (!references.ok()) return references.status();

  context->EnterPhase(BuildPhase::kTop);
  absl::StatusOr<SplitTree> tree = [&] {
    const BuildContext::CpuTime time(*context);
    return BuildTopDown(*std::move(references), mesh->triangles(), options.config, *context);
  }();
  if (!tree.ok()) return tree.status();

  context->EnterPhase(BuildPhase::kLayout);
  (void)publish_provisional;
  const BuildContext::CpuTime time(*context);
  return MakeTree<Bvh>(mesh, ToBvhArrays(*tree));
}

}  // namespace deltaray
