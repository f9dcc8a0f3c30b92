// A seeded source of random numbers that gives the same ones with every compiler and library.

#ifndef TESTS_SCENES_RANDOM_H_
#define TESTS_SCENES_RANDOM_H_

#include <cmath>
#include <cstdint>
#include <random>

#include "server/geometry/vec3.h"

namespace deltaray {

class Random {
 public:
  explicit Random(uint64_t seed) : engine_(seed) {}

  // In [0, 1). std::uniform_real_distribution may differ between libraries.
  double Uniform() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  double Uniform(double from, double to) { return from + (to - from) * Uniform(); }
  // Each decade between `from` and `to` is as likely as another.
  double LogUniform(double from, double to) { return std::exp2(Uniform(std::log2(from), std::log2(to))); }
  // In [0, count). REQUIRES: count > 0.
  uint32_t Below(uint32_t count) { return static_cast<uint32_t>((engine_() >> 32) * count >> 32); }

  Vec3d InUnitBox() {
    const double x = Uniform(), y = Uniform(), z = Uniform();
    return {x, y, z};
  }
  Vec3d OnUnitSphere() {
    while (true) {
      const Vec3d p = 2.0 * InUnitBox() - Vec3d{1, 1, 1};
      const double length = Length(p);
      if (length > 0.01 && length <= 1) return (1 / length) * p;
    }
  }

 private:
  std::mt19937_64 engine_;
};

}  // namespace deltaray

#endif  // TESTS_SCENES_RANDOM_H_
