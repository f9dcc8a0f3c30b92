// Builds that tests start.

#ifndef TESTS_UNIT_BUILD_BUILDS_H_
#define TESTS_UNIT_BUILD_BUILDS_H_

#include <functional>
#include <memory>
#include <utility>

#include "gtest/gtest.h"
#include "server/build/build.h"

namespace deltaray {

inline std::shared_ptr<const TriangleMesh> Shared(TriangleMesh mesh) {
  return std::make_shared<const TriangleMesh>(std::move(mesh));
}

inline std::shared_ptr<Build> Start(const std::shared_ptr<const TriangleMesh>& mesh, const Config& config,
                                    uint32_t threads = 2, std::function<void()> on_delta_leaf = nullptr) {
  EXPECT_TRUE(Validate(config).ok());
  return Build::Start(mesh, {.config = config, .threads = threads, .on_delta_leaf = std::move(on_delta_leaf)});
}

}  // namespace deltaray

#endif  // TESTS_UNIT_BUILD_BUILDS_H_
