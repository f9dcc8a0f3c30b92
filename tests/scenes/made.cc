#include "tests/scenes/made.h"

#include <cmath>

#include "tests/scenes/random.h"
#include "tests/scenes/shapes.h"

namespace deltaray {
namespace {

constexpr Vec3d kUp{0, 0, 1};

// A number in [0, 1) for each point of the integer lattice: the finaliser of SplitMix64.
double LatticeNoise(uint64_t x, uint64_t y, uint64_t seed) {
  uint64_t z = seed + x * 0x9E3779B97F4A7C15 + y * 0xD1B54A32D192ED03;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EB;
  return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

// Value noise between lattice points, smooth up to the first derivative.
double SmoothNoise(double x, double y, uint64_t seed) {
  const double fx = std::floor(x), fy = std::floor(y);
  const auto ix = static_cast<uint64_t>(fx), iy = static_cast<uint64_t>(fy);
  const auto ease = [](double s) { return s * s * (3 - 2 * s); };
  const double sx = ease(x - fx), sy = ease(y - fy);
  const double low = std::lerp(LatticeNoise(ix, iy, seed), LatticeNoise(ix + 1, iy, seed), sx);
  const double high = std::lerp(LatticeNoise(ix, iy + 1, seed), LatticeNoise(ix + 1, iy + 1, seed), sx);
  return std::lerp(low, high, sy);
}

}  // namespace

TriangleMesh City(uint32_t blocks, uint32_t cables, uint64_t seed) {
  constexpr double kSize = 3000;
  TriangleMesh mesh;
  Random random(seed);
  AddParallelogram(&mesh, {0, 0, 0}, {kSize, 0, 0}, {0, kSize, 0});

  const double pitch = kSize / blocks;
  for (uint32_t i = 0; i < blocks; ++i) {
    for (uint32_t j = 0; j < blocks; ++j) {
      const Frame frame = RandomFrame(kUp, random);
      const double height = random.LogUniform(0.3, 300);
      const double width = random.LogUniform(0.3, 50), depth = random.LogUniform(0.3, 50);
      AddBox(&mesh, {(i + 0.5) * pitch, (j + 0.5) * pitch, height / 2}, frame, {height / 2, width / 2, depth / 2});
    }
  }

  for (uint32_t i = 0; i < cables; ++i) {
    const double length = random.LogUniform(15, 1500);
    const Frame frame = RandomFrame(random.OnUnitSphere(), random);
    const Vec3d along{length * frame[0].x, length * frame[0].y, 0.1 * length * frame[0].z};
    const double x = random.Uniform(0, kSize), y = random.Uniform(0, kSize), z = random.Uniform(5, 200);
    AddParallelogram(&mesh, {x, y, z}, along, 0.02 * frame[1]);
  }
  return mesh;
}

TriangleMesh Soup(uint32_t triangles, uint64_t seed) {
  TriangleMesh mesh;
  Random random(seed);
  const double largest = 22 / std::sqrt(triangles);
  for (uint32_t i = 0; i < triangles; ++i) {
    const Vec3d centre = random.InUnitBox();
    const double size = random.LogUniform(1e-3 * largest, largest);
    const Vec3d a = centre + size * random.OnUnitSphere();
    const Vec3d b = centre + size * random.OnUnitSphere();
    const Vec3d c = centre + size * random.OnUnitSphere();
    AddTriangle(&mesh, a, b, c);
  }
  return mesh;
}

TriangleMesh Terrain(uint32_t width, uint32_t depth, uint64_t seed) {
  TriangleMesh mesh;
  const auto stride = static_cast<uint64_t>(width) + 1;
  mesh.positions.reserve(stride * (depth + 1));
  mesh.indices.reserve(2 * static_cast<uint64_t>(width) * depth);
  for (uint32_t y = 0; y <= depth; ++y) {
    for (uint32_t x = 0; x <= width; ++x) {
      double height = 0;
      for (int octave = 0; octave < 6; ++octave) {
        height +=
            std::ldexp(8 * SmoothNoise(std::ldexp(x, octave - 6), std::ldexp(y, octave - 6), seed + octave), -octave);
      }
      mesh.positions.push_back(static_cast<Vec3f>(Vec3d{static_cast<double>(x), static_cast<double>(y), height}));
    }
  }
  for (uint32_t y = 0; y < depth; ++y) {
    for (uint32_t x = 0; x < width; ++x) {
      const auto corner = static_cast<uint32_t>(y * stride + x);
      const auto above = static_cast<uint32_t>(corner + stride);
      mesh.indices.push_back({corner, corner + 1, above + 1});
      mesh.indices.push_back({corner, above + 1, above});
    }
  }
  mesh.face_count = mesh.indices.size();
  return mesh;
}

}  // namespace deltaray
