// Embree, the peer that kernels and builds are compared with. Nothing else of the benchmarks sees its headers.

#ifndef TESTS_BENCH_EMBREE_H_
#define TESTS_BENCH_EMBREE_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "server/mesh/triangle_mesh.h"
#include "server/tree/simd_target.h"
#include "tests/bench/kernel.h"
#include "tests/bench/measure.h"

namespace deltaray {

// One scene of one mesh.
class EmbreeScene {
 public:
  enum class Quality { kMedium, kHigh };
  struct Options {
    Quality quality = Quality::kHigh;
    // RTC_SCENE_FLAG_ROBUST. Embree then splits no triangles, whatever the quality.
    bool robust = false;
    // Threads to build with. 0: all cores.
    uint32_t threads = 0;
    // What Embree may use of the machine. Nothing: its own choice.
    std::optional<SimdTarget> simd_target = std::nullopt;
  };

  // UNIMPLEMENTED where the program was built without Embree.
  static absl::StatusOr<std::unique_ptr<EmbreeScene>> Build(const TriangleMesh& mesh, const Options& options);
  virtual ~EmbreeScene() = default;

  virtual const BuildCost& build_cost() const = 0;

  // The calls that rays can be asked by: "single" (rtcIntersect1), "1M" (rtcIntersect1M), "1M_coherent" (the same,
  // told that rays are alike), and "16" or "8" (rtcIntersect16, rtcIntersect8), whichever is the widest that the device
  // has instructions for. Likewise rtcOccluded...
  virtual std::vector<std::string> modes() const = 0;

  // REQUIRES: `mode` is one of modes(). The scene must outlive the kernel.
  virtual std::unique_ptr<Kernel> MakeKernel(std::string_view mode, Question question) const = 0;
};

// Whether the program was built with Embree.
bool HaveEmbree();
// "Embree 3.13.5", or why there is none.
std::string EmbreeVersion();

}  // namespace deltaray

#endif  // TESTS_BENCH_EMBREE_H_
