#include "server/build/run_build.h"

#include <algorithm>
#include <new>
#include <utility>
#include <vector>

#include "server/build/auto_config.h"
#include "server/build/delta_leaf.h"
#include "server/build/delta_leaf_tasks.h"
#include "server/build/kd_tree_builder.h"
#include "server/build/layout.h"
#include "server/build/lazy_tree.h"
#include "server/build/reference.h"
#include "server/build/tang2015_builder.h"
#include "server/build/top_down.h"
#include "server/build/wide_layout.h"
#include "server/tree/bvh.h"
#include "server/tree/kd_tree.h"
#include "server/tree/simd_target.h"
#include "server/tree/wide_node.h"
#include "server/tree/wide_tree.h"

namespace deltaray {
namespace {

// A tree that keeps its mesh alive.
template <typename T, typename... Arguments>
std::shared_ptr<T> MakeTree(const std::shared_ptr<const TriangleMesh>& mesh, Arguments&&... arguments) {
  struct Owner {
    std::shared_ptr<const TriangleMesh> mesh;
    T tree;
    Owner(const std::shared_ptr<const TriangleMesh>& mesh, Arguments&&... arguments)
        : mesh(mesh), tree(mesh->triangles(), std::forward<Arguments>(arguments)...) {}
  };
  auto owner = std::make_shared<Owner>(mesh, std::forward<Arguments>(arguments)...);
  return std::shared_ptr<T>(owner, &owner->tree);
}

// Runs a phase, and counts this thread's time in it.
template <typename Work>
auto RunPhase(BuildContext& context, BuildPhase phase, Work&& work) {
  context.EnterPhase(phase);
  const BuildContext::CpuTime time(context);
  return work();
}

// A leaf of a wide tree has no room for more.
Config ForLeavesOf(Config config) {
  if (config.builder != Builder::kKdTree) config.max_leaf_size = std::min(config.max_leaf_size, kMaxLeafTriangles);
  return config;
}

// One build, phase by phase.
class Run {
 public:
  Run(const std::shared_ptr<const TriangleMesh>& mesh, const Build::Options& options,
      const std::shared_ptr<BuildContext>& context,
      const std::function<void(std::shared_ptr<const Tree>)>& publish_provisional)
      : mesh_(mesh),
        options_(options),
        config_(ForLeavesOf(options_.config)),
        context_(context),
        publish_provisional_(publish_provisional) {}

  absl::StatusOr<std::shared_ptr<const Tree>> Build() {
    absl::StatusOr<ReferenceArray> references = RunPhase(*context_, BuildPhase::kReferences, [&] {
      absl::StatusOr<ReferenceArray> references =
          MakeReferences(mesh_->triangles(), config_.duplication_budget, *context_);
      if (references.ok()) Choose(*references);
      return references;
    });
    if (!references.ok()) return references.status();
    switch (config_.builder) {
      case Builder::kHybrid:
        return BuildWithDeltaLeaves(
            [&] { return BuildTop(*std::move(references), mesh_->triangles(), config_, *context_); },
            [config = config_, context = context_.get()](std::span<const Reference> delta_leaf, const Bounds& all) {
              return BuildDeltaLeaf(delta_leaf, all, config, *context);
            });
      case Builder::kKdTree:
        return BuildKd(*std::move(references));
      case Builder::kTang2015:
        return BuildWithDeltaLeaves(
            [&] { return BuildTang2015Top(*std::move(references), config_, *context_); },
            [config = config_, context = context_.get()](std::span<const Reference> delta_leaf, const Bounds& all) {
              return BuildTang2015DeltaLeaf(delta_leaf, all, config, *context);
            });
      case Builder::kBvh:
      case Builder::kSbvh:
        return BuildBvh(*std::move(references));
    }
    return absl::InternalError("a build was asked for that there is no builder for");
  }

 private:
  // Settles what the config that was asked for leaves open.
  void Choose(ReferenceArray& references) {
    ChosenConfig chosen = ChooseConfig(config_, references.span(), *context_);
    if (chosen.reasons.empty()) return;
    config_ = chosen.config;
    if (config_.duplication_budget == 0) references.ShrinkToFit();
    context_->SetChoice(config_, std::move(chosen.reasons));
  }

  absl::StatusOr<std::shared_ptr<const Tree>> BuildBvh(ReferenceArray references) {
    const absl::StatusOr<SplitTree> tree = RunPhase(*context_, BuildPhase::kTop, [&] {
      return BuildTopDown(std::move(references), mesh_->triangles(), config_, *context_);
    });
    if (!tree.ok()) return tree.status();
    return RunPhase(*context_, BuildPhase::kLayout, [&] { return Collapse(ToBvhArrays(*tree)); });
  }

  absl::StatusOr<std::shared_ptr<const Tree>> BuildKd(ReferenceArray references) {
    absl::StatusOr<KdArrays> arrays = RunPhase(*context_, BuildPhase::kTop, [&] {
      return BuildKdTree(references.span(), mesh_->triangles(), config_, *context_);
    });
    if (!arrays.ok()) return arrays.status();
    return RunPhase(*context_, BuildPhase::kLayout, [&] { return MakeTree<KdTree>(mesh_, *std::move(arrays)); });
  }

  // The flow of the hybrid: top, provisional tree, δ-leaves, final tree.
  template <typename BuildTopOfIt>
  absl::StatusOr<std::shared_ptr<const Tree>> BuildWithDeltaLeaves(BuildTopOfIt&& build_top,
                                                                   DeltaLeafTasks::BuildOne build_one) {
    std::shared_ptr<DeltaLeafTasks> tasks;
    const absl::StatusOr<FirstTree> first = RunPhase(*context_, BuildPhase::kTop, [&]() -> absl::StatusOr<FirstTree> {
      absl::StatusOr<SplitTree> top = build_top();
      if (!top.ok()) return top.status();
      tasks = std::make_shared<DeltaLeafTasks>(*std::move(top), std::move(build_one), options_.on_delta_leaf, context_);
      return MakeFirstTree(tasks);
    });
    if (!first.ok()) return first.status();
    if (first->is_final) return first->tree;
    if (first->tree != nullptr) publish_provisional_(first->tree);
    const absl::Status built = RunPhase(*context_, BuildPhase::kDeltaLeaves, [&] { return tasks->BuildAll(); });
    if (!built.ok()) return built;
    return RunPhase(*context_, BuildPhase::kLayout, [&]() -> absl::StatusOr<std::shared_ptr<const Tree>> {
      absl::StatusOr<BinaryLayout> layout = LayOut(*tasks, *context_);
      if (!layout.ok()) return layout.status();
      // Its memory is wanted for the wide tree.
      tasks = nullptr;
      // As printed there are no wide nodes.
      if (config_.builder == Builder::kTang2015) return MakeTree<Bvh>(mesh_, std::move(layout->arrays));
      return Collapse(std::move(layout->arrays));
    });
  }

  // What rays can go through while no δ-leaf is built.
  struct FirstTree {
    std::shared_ptr<const Tree> tree;
    bool is_final = false;
  };
  absl::StatusOr<FirstTree> MakeFirstTree(const std::shared_ptr<DeltaLeafTasks>& tasks) {
    if (config_.lazy && HaveTarget()) {
      absl::StatusOr<std::shared_ptr<const LazyTree::Version>> version =
          LazyTree::LayOutVersion(mesh_->triangles(), tasks, Target(), *context_);
      if (version.ok()) return FirstTree{MakeTree<LazyTree>(mesh_, *std::move(version), Target(), context_), true};
      if (!absl::IsResourceExhausted(version.status())) return version.status();
    }
    // The final tree will be there as soon as a provisional one would be.
    if (config_.preset == Preset::kFast) return FirstTree{};
    absl::StatusOr<BinaryLayout> layout = LayOut(*tasks, *context_);
    if (!layout.ok()) return layout.status();
    absl::StatusOr<std::shared_ptr<const Tree>> tree = Collapse(std::move(layout->arrays));
    if (!tree.ok()) return tree.status();
    return FirstTree{*std::move(tree)};
  }

  // Makes the wide tree; the binary one where the processor or the mesh's size rules that out.
  absl::StatusOr<std::shared_ptr<const Tree>> Collapse(BvhArrays arrays) {
    if (!HaveTarget()) return MakeTree<Bvh>(mesh_, std::move(arrays));
    absl::StatusOr<WideArrays> wide = LayOutWide(arrays, mesh_->triangles(), Target(), *context_);
    if (absl::IsResourceExhausted(wide.status())) return MakeTree<Bvh>(mesh_, std::move(arrays));
    if (!wide.ok()) return wide.status();
    return MakeTree<WideTree>(mesh_, *std::move(wide));
  }

  static bool HaveTarget() { return !SupportedSimdTargets().empty(); }
  // REQUIRES: HaveTarget().
  SimdTarget Target() const { return options_.simd_target.value_or(SupportedSimdTargets().back()); }

  const std::shared_ptr<const TriangleMesh>& mesh_;
  const Build::Options& options_;
  Config config_;
  const std::shared_ptr<BuildContext>& context_;
  const std::function<void(std::shared_ptr<const Tree>)>& publish_provisional_;
};

}  // namespace

absl::StatusOr<std::shared_ptr<const Tree>> RunBuild(
    const std::shared_ptr<const TriangleMesh>& mesh, const Build::Options& options,
    const std::shared_ptr<BuildContext>& context,
    const std::function<void(std::shared_ptr<const Tree>)>& publish_provisional) {
  return Run(mesh, options, context, publish_provisional).Build();
}

}  // namespace deltaray
