// The scenes of the property tests, small enough for brute force, and the rays at them.

#ifndef TESTS_PROPERTY_TEST_SCENES_H_
#define TESTS_PROPERTY_TEST_SCENES_H_

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "server/geometry/ray.h"
#include "server/mesh/triangle_mesh.h"

namespace deltaray {

struct TestScene {
  std::string name;
  std::shared_ptr<const TriangleMesh> mesh;
  size_t ray_count = 0;
};

// The names of all of them: made scenes, every pathological one, and the bunny.
std::vector<std::string> TestSceneNames();
// REQUIRES: `name` is one of TestSceneNames().
TestScene MakeTestScene(const std::string& name);

// scene.ray_count rays, always the same ones: of every hard family and of those in common use, in random order, so that
// any part of them is as good a sample as another.
std::vector<Ray> TestRays(const TestScene& scene);

}  // namespace deltaray

#endif  // TESTS_PROPERTY_TEST_SCENES_H_
