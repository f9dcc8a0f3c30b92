#include "server/build/wide_plan.h"

#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <limits>
#include <vector>

#include "server/geometry/packed_bounds.h"
#include "server/tree/wide_node.h"

namespace deltaray {
namespace {

constexpr int kMaxWidth = 16;
// Subtrees of fewer nodes are solved by one task.
constexpr uint32_t kTaskNodes = 4096;

}  // namespace

// Costs of the cheapest forests over one subtree.
struct WidePlan::Forest {
  int roots = 1;              // most roots that it can have, up to the width
  uint32_t references;        // below, up to kMaxLeafTriangles + 1
  float cost[kMaxWidth + 1];  // [j]: with at most j roots, 1 <= j <= roots
};

WidePlan::WidePlan(std::span<const BvhNode> nodes, int width, BuildContext& context)
    : nodes_(nodes),
      width_(width),
      scale_(UnitScale(nodes[0].bounds)),
      choices_(LargeArray<uint8_t>::Cleared(nodes.size() * width)) {
  Solve(0, static_cast<uint32_t>(nodes.size()), context);
}

float WidePlan::HalfArea(uint32_t node) const { return PackedBounds(nodes_[node].bounds).HalfArea(scale_); }

WidePlan::Forest WidePlan::Solve(uint32_t begin, uint32_t end, BuildContext& context) {
  if (context.cancelled()) {
    Forest forest;
    forest.references = 0;
    forest.cost[1] = 0;
    return forest;
  }
  if (end - begin <= kTaskNodes) {
    const BuildContext::CpuTime time(context);
    return SolveSerially(begin, end);
  }
  const uint32_t middle = nodes_[begin].offset;
  Forest left, right;
  tbb::parallel_invoke([&] { left = Solve(begin + 1, middle, context); }, [&] { right = Solve(middle, end, context); });
  return Join(begin, left, right);
}

// Children stand behind their parents, so that going backwards the forests of a node's children are the last two that
// are not joined yet.
WidePlan::Forest WidePlan::SolveSerially(uint32_t begin, uint32_t end) {
  std::vector<Forest> forests;
  for (uint32_t node = end; node-- > begin;) {
    if (nodes_[node].IsLeaf()) {
      forests.push_back(SolveLeaf(node));
      continue;
    }
    const Forest left = forests.back();
    forests.pop_back();
    forests.back() = Join(node, left, forests.back());
  }
  return forests.back();
}

WidePlan::Forest WidePlan::SolveLeaf(uint32_t node) {
  Forest forest;
  forest.references = nodes_[node].count;
  forest.cost[1] = kLeafCost * HalfArea(node);
  choices_[size_t{node} * width_] = static_cast<uint8_t>(nodes_[node].count);
  return forest;
}

WidePlan::Forest WidePlan::Join(uint32_t node, const Forest& left, const Forest& right) {
  uint8_t* const choices = &choices_[size_t{node} * width_];
  Forest forest;
  forest.roots = std::min(left.roots + right.roots, width_);
  forest.references = std::min(left.references + right.references, kMaxLeafTriangles + 1);

  // 1. Share j roots among the two parts.
  for (int j = 2; j <= forest.roots; ++j) {
    float least = std::numeric_limits<float>::infinity();
    int share = 0;
    for (int k = std::max(1, j - right.roots); k <= std::min(j - 1, left.roots); ++k) {
      const float cost = left.cost[k] + right.cost[j - k];
      if (cost < least) least = cost, share = k;
    }
    forest.cost[j] = least;
    choices[j - 1] = static_cast<uint8_t>(share);
  }

  // 2. Make one root of it: a node over the widest forest, or a leaf.
  const float half_area = HalfArea(node);
  forest.cost[1] = kNodeCost * half_area + forest.cost[forest.roots];
  if (forest.references <= kMaxLeafTriangles && kLeafCost * half_area <= forest.cost[1]) {
    forest.cost[1] = kLeafCost * half_area;
    choices[0] = static_cast<uint8_t>(forest.references);
  }

  // 3. Have fewer roots where more are no cheaper.
  for (int j = 2; j <= forest.roots; ++j) {
    if (forest.cost[j] < forest.cost[j - 1]) continue;
    forest.cost[j] = forest.cost[j - 1];
    choices[j - 1] = 0;
  }
  return forest;
}

int WidePlan::Children(uint32_t node, uint32_t* children) const {
  const uint8_t* const choices = &choices_[size_t{node} * width_];
  int roots = width_;
  while (roots > 1 && choices[roots - 1] == 0) --roots;
  uint32_t* end = children;
  // Where areas are 0 no forest is cheaper than the node itself: its two children then.
  const int first = roots > 1 ? choices[roots - 1] : 1, second = roots > 1 ? roots - first : 1;
  AppendRoots(node + 1, first, end);
  AppendRoots(nodes_[node].offset, second, end);
  return static_cast<int>(end - children);
}

void WidePlan::AppendRoots(uint32_t node, int roots, uint32_t*& children) const {
  const uint8_t* const choices = &choices_[size_t{node} * width_];
  while (roots > 1 && choices[roots - 1] == 0) --roots;
  if (roots == 1) {
    *children++ = node;
    return;
  }
  AppendRoots(node + 1, choices[roots - 1], children);
  AppendRoots(nodes_[node].offset, roots - choices[roots - 1], children);
}

}  // namespace deltaray
