#include "tests/bench/kernel.h"

#include <algorithm>
#include <cstdint>
#include <vector>

namespace deltaray {
namespace {

class DeltarayWorker final : public Kernel::Worker {
 public:
  DeltarayWorker(const Tree& tree, const QueryOptions& options, Question question, size_t max_rays)
      : tree_(tree), options_(options), question_(question), hits_(max_rays), any_(max_rays) {
    rays_.reserve(max_rays);
  }

  void Load(std::span<const Ray> rays) override { rays_.assign(rays.begin(), rays.end()); }

  void Trace() override {
    if (question_ == Question::kAnyHit) {
      tree_.AnyHits(rays_, options_, std::span(any_).first(rays_.size()));
    } else {
      tree_.ClosestHits(rays_, options_, std::span(hits_).first(rays_.size()));
    }
  }

  void Store(std::span<Hit> hits) const override {
    if (question_ == Question::kClosestHit) {
      std::copy_n(hits_.begin(), hits.size(), hits.begin());
    } else {
      for (size_t i = 0; i < hits.size(); ++i) hits[i] = any_[i] != 0 ? Hit{.t = 0} : Hit{};
    }
  }

 private:
  const Tree& tree_;
  const QueryOptions options_;
  const Question question_;
  std::vector<Ray> rays_;
  std::vector<Hit> hits_;
  std::vector<uint8_t> any_;
};

class DeltarayKernel final : public Kernel {
 public:
  DeltarayKernel(const Tree& tree, const QueryOptions& options, Question question)
      : tree_(tree), options_(options), question_(question) {}

  std::unique_ptr<Worker> MakeWorker(size_t max_rays) const override {
    return std::make_unique<DeltarayWorker>(tree_, options_, question_, max_rays);
  }

 private:
  const Tree& tree_;
  const QueryOptions options_;
  const Question question_;
};

}  // namespace

std::unique_ptr<Kernel> MakeDeltarayKernel(const Tree& tree, const QueryOptions& options, Question question) {
  return std::make_unique<DeltarayKernel>(tree, options, question);
}

}  // namespace deltaray
