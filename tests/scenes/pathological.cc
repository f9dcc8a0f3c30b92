#include "tests/scenes/pathological.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>

#include "tests/scenes/made.h"
#include "tests/scenes/random.h"
#include "tests/scenes/shapes.h"

namespace deltaray {
namespace {

constexpr Frame kAxes = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

uint32_t Side(uint32_t cells) { return std::max(1u, static_cast<uint32_t>(std::sqrt(cells))); }

// A sphere of about `triangles` triangles.
TriangleMesh Sphere(uint32_t triangles, Vec3d centre, double radius) {
  TriangleMesh mesh;
  AddSphere(&mesh, centre, radius, std::max(2u, static_cast<uint32_t>(std::sqrt(triangles / 4.0))));
  return mesh;
}

// All triangles meet in one vertex: no plane through it parts them.
TriangleMesh Fan(uint32_t size) {
  TriangleMesh mesh;
  mesh.positions.push_back({0.25f, 0.125f, 0.5f});
  for (uint32_t i = 0; i < size; ++i) {
    const double angle = 2 * std::numbers::pi * i / size;
    mesh.positions.push_back(static_cast<Vec3f>(Vec3d{std::cos(angle), std::sin(angle), 0.1 * std::sin(7 * angle)}));
  }
  for (uint32_t i = 0; i < size; ++i) mesh.indices.push_back({0, 1 + i, 1 + (i + 1) % size});
  mesh.face_count = size;
  return mesh;
}

// One triangle many times over, with the same vertices.
TriangleMesh Copies(uint32_t size) {
  TriangleMesh mesh;
  mesh.positions = {{0, 0, 0}, {1, 0.25f, 0.125f}, {0.25f, 1, 0.5f}};
  mesh.indices.assign(size, {0, 1, 2});
  mesh.face_count = size;
  return mesh;
}

// One triangle many times over, with vertices of its own each time, every order of corners in turn.
TriangleMesh Coincident(uint32_t size) {
  TriangleMesh mesh;
  std::array<Vec3d, 3> corners = {{{0, 0, 0}, {1, 0.25, 0.125}, {0.25, 1, 0.5}}};
  for (uint32_t i = 0; i < size; ++i) {
    AddTriangle(&mesh, corners[0], corners[1], corners[2]);
    std::swap(corners[i % 3], corners[(i + 1) % 3]);
  }
  return mesh;
}

TriangleMesh NestedBoxes(uint32_t size) {
  TriangleMesh mesh;
  for (uint32_t i = 1; i <= size; ++i) {
    const double half = static_cast<double>(i) / size;
    AddBox(&mesh, {0, 0, 0}, kAxes, {half, half, half});
  }
  return mesh;
}

// Needles in all directions, 1 : 1 to 1 : 1e8.
TriangleMesh Slivers(uint32_t size) {
  TriangleMesh mesh;
  Random random(11);
  for (uint32_t i = 0; i < size; ++i) {
    const Frame frame = RandomFrame(random.OnUnitSphere(), random);
    const Vec3d a = random.InUnitBox();
    AddTriangle(&mesh, a, a + frame[0], a + random.LogUniform(1e-8, 1) * frame[1]);
  }
  return mesh;
}

// Right triangles whose corners are small integers, so that rays can meet vertices and edges exactly.
TriangleMesh IntegerGrid(uint32_t size) {
  TriangleMesh mesh = Terrain(Side(size), Side(size));
  Random random(12);
  for (Vec3f& p : mesh.positions) p.z = static_cast<float>(random.Below(4));
  return mesh;
}

TriangleMesh HugeAmongTiny(uint32_t size) {
  TriangleMesh mesh;
  Random random(13);
  AddTriangle(&mesh, {-1, -1, 0.5}, {3, -1, 0.6}, {-1, 3, 0.4});
  for (uint32_t i = 0; i < size; ++i) {
    const Vec3d p = random.InUnitBox();
    const Vec3d b = p + 1e-3 * random.OnUnitSphere(), c = p + 1e-3 * random.OnUnitSphere();
    AddTriangle(&mesh, p, b, c);
  }
  return mesh;
}

// A small round thing far inside a hall that is 1e5 times larger.
TriangleMesh TeapotInStadium(uint32_t size) {
  TriangleMesh mesh = Sphere(size, {13.7, 21.3, 0.5}, 0.5);
  AddBox(&mesh, {0, 0, 0}, kAxes, {1e5, 1e5, 1e4});
  return mesh;
}

TriangleMesh Denormal(uint32_t size) { return Sphere(size, {0, 0, 0}, 1e-40); }
TriangleMesh Tiny(uint32_t size) { return Sphere(size, {0, 0, 0}, 1e-20); }
TriangleMesh Huge(uint32_t size) { return Sphere(size, {0, 0, 0}, 1e30); }
TriangleMesh FarFromOrigin(uint32_t size) { return Sphere(size, {1e7, -1e7, 1e7}, 100); }

// Corners of every magnitude that float has, both signs.
TriangleMesh MixedMagnitudes(uint32_t size) {
  TriangleMesh mesh;
  Random random(14);
  for (uint32_t i = 0; i < size; ++i) {
    std::array<Vec3d, 3> corners;
    for (Vec3d& corner : corners) corner = random.LogUniform(1e-44, 1e30) * random.OnUnitSphere();
    AddTriangle(&mesh, corners[0], corners[1], corners[2]);
  }
  return mesh;
}

// Every other triangle has no area: three points on a line, two corners alike, or all three.
TriangleMesh HalfDegenerate(uint32_t size) {
  TriangleMesh mesh;
  Random random(15);
  for (uint32_t i = 0; i < size; ++i) {
    const Vec3d a = random.InUnitBox(), b = random.InUnitBox(), c = random.InUnitBox();
    switch (i % 6) {
      case 1:
        AddTriangle(&mesh, a, a, a);
        break;
      case 3:
        AddTriangle(&mesh, a, b, a);
        break;
      case 5:
        // Powers of two, so that the three points stay on their line once rounded.
        AddTriangle(&mesh, {0.25, 0.25, 0.25}, {0.5, 0.5, 0.5}, {1, 1, 1});
        break;
      default:
        AddTriangle(&mesh, a, b, c);
    }
  }
  return mesh;
}

TriangleMesh AllDegenerate(uint32_t size) {
  TriangleMesh mesh;
  Random random(16);
  for (uint32_t i = 0; i < size; ++i) {
    const Vec3d a = random.InUnitBox();
    AddTriangle(&mesh, a, a, random.InUnitBox());
  }
  return mesh;
}

// Squares of one plane: every box is flat, and every kd plane across it runs along edges.
TriangleMesh FlatGrid(uint32_t size) {
  TriangleMesh mesh = Terrain(Side(size), Side(size));
  for (Vec3f& p : mesh.positions) p.z = 0.5f;
  return mesh;
}

// Boxes wall to wall: pairs of faces that coincide, in planes where builders like to split.
TriangleMesh Voxels(uint32_t size) {
  TriangleMesh mesh;
  const auto side = std::max(1u, static_cast<uint32_t>(std::cbrt(size)));
  for (uint32_t i = 0; i < side * side * side; ++i) {
    const Vec3d centre{i % side + 0.5, i / side % side + 0.5, static_cast<double>(i / side / side) + 0.5};
    AddBox(&mesh, centre, kAxes, {0.5, 0.5, 0.5});
  }
  return mesh;
}

// Triangles in overlapping layers of one plane, all different.
TriangleMesh CoplanarOverlap(uint32_t size) {
  TriangleMesh mesh;
  Random random(17);
  for (uint32_t i = 0; i < size; ++i) {
    std::array<Vec3d, 3> corners;
    for (Vec3d& corner : corners) corner = {random.Uniform(), random.Uniform(), 0.25};
    AddTriangle(&mesh, corners[0], corners[1], corners[2]);
  }
  return mesh;
}

// Rows of triangles whose vertices lie on their neighbours' edges.
TriangleMesh TJunctions(uint32_t size) {
  TriangleMesh mesh;
  const uint32_t side = Side(size);
  for (uint32_t y = 0; y < side; ++y) {
    const uint32_t cells = 1 + y % 3;
    for (uint32_t x = 0; x < side * cells; ++x) {
      const double width = 1.0 / cells;
      AddParallelogram(&mesh, {x * width, static_cast<double>(y), 0.0}, {width, 0, 0}, {0, 1, 0});
    }
  }
  return mesh;
}

// Boxes of every power of two about one point: each split parts off one of them.
TriangleMesh GeometricSeries(uint32_t size) {
  TriangleMesh mesh;
  for (uint32_t i = 0; i < std::min(size, 120u); ++i) {
    const double half = std::ldexp(1.0, static_cast<int>(i) - 60);
    AddBox(&mesh, {half, half, half}, kAxes, {half / 2, half / 2, half / 2});
  }
  return mesh;
}

TriangleMesh UnitSphere(uint32_t size) { return Sphere(size, {0, 0, 0}, 1); }
// Farther from zero than it is large by as much as leaves its vertices some ten bits.
TriangleMesh Distant(uint32_t size) { return Sphere(size, {1e4, 1e4, -1e4}, 1); }

// Triangles one step of float wide, side by side, that meet in one vertex.
TriangleMesh NeedleFan(uint32_t size) {
  TriangleMesh mesh;
  mesh.positions.push_back({0, 0, 0.5f});
  for (uint32_t i = 0; i <= size; ++i) mesh.positions.push_back({1, 1 + static_cast<float>(i) * 0x1p-23f, 0.25f});
  for (uint32_t i = 0; i < size; ++i) mesh.indices.push_back({0, 1 + i, 2 + i});
  mesh.face_count = size;
  return mesh;
}

// Moves coordinates by one step of float up or down, or not at all.
Vec3d Jitter(Vec3d p, Random& random) {
  for (int axis = 0; axis < 3; ++axis) {
    const auto x = static_cast<float>(p[axis]);
    const float towards[] = {x, -Bounds::kInfinity, Bounds::kInfinity};
    p[axis] = std::nextafter(x, towards[random.Below(3)]);
  }
  return p;
}

// Squares of a sheet that do not quite share their vertices, so that there are cracks and overlaps one step wide.
TriangleMesh UlpCracks(uint32_t size) {
  TriangleMesh mesh;
  Random random(18);
  const uint32_t side = Side(size);
  const auto point = [&](uint32_t x, uint32_t y) {
    return Jitter(Vec3d{x / 3.0, y / 3.0, 0.7 + 0.1 * (x % 3) - 0.1 * (y % 2)}, random);
  };
  for (uint32_t y = 0; y < side; ++y) {
    for (uint32_t x = 0; x < side; ++x) {
      const Vec3d a = point(x, y), b = point(x + 1, y), c = point(x + 1, y + 1), d = point(x, y + 1);
      const Vec3d other_a = Jitter(a, random), other_c = Jitter(c, random);
      AddTriangle(&mesh, a, b, c);
      AddTriangle(&mesh, other_a, other_c, d);
    }
  }
  return mesh;
}

// Triangles about one plane, which they leave by one step of float at most: they cross, and what is between them is
// less.
TriangleMesh UlpLayers(uint32_t size) {
  TriangleMesh mesh;
  Random random(19);
  const auto corner = [&](double x, double y) { return Jitter({x + 0.1 * random.Uniform(), y, 1}, random); };
  for (uint32_t i = 0; i < size; ++i) {
    const Vec3d a = corner(0, 0), b = corner(1, 0.1), c = corner(0.3, 1);
    AddTriangle(&mesh, a, b, c);
  }
  return mesh;
}

// Corners of random bits, all of them finite numbers.
TriangleMesh AnyBits(uint32_t size) {
  TriangleMesh mesh;
  Random random(20);
  const auto coordinate = [&] {
    while (true) {
      const auto x = std::bit_cast<float>(random.Below(0xFFFFFFFF));
      if (std::isfinite(x)) return static_cast<double>(x);
    }
  };
  const auto corner = [&] {
    const double x = coordinate(), y = coordinate(), z = coordinate();
    return Vec3d{x, y, z};
  };
  for (uint32_t i = 0; i < size; ++i) {
    const Vec3d a = corner(), b = corner(), c = corner();
    AddTriangle(&mesh, a, b, c);
  }
  return mesh;
}

TriangleMesh Single(uint32_t) { return Copies(1); }
TriangleMesh Empty(uint32_t) { return {}; }

constexpr PathologicalScene kScenes[] = {
    {"fan", Fan, 20'000, 48},
    {"copies", Copies, 10'000, 24},
    {"coincident", Coincident, 300, 24},
    {"nested_boxes", NestedBoxes, 500, 30},
    {"slivers", Slivers, 5'000, 600},
    {"integer_grid", IntegerGrid, 5'000, 600},
    {"huge_among_tiny", HugeAmongTiny, 150'000, 600},
    {"teapot_in_stadium", TeapotInStadium, 10'000, 600},
    {"denormal", Denormal, 5'000, 600},
    {"tiny", Tiny, 5'000, 600},
    {"huge", Huge, 5'000, 600},
    {"far_from_origin", FarFromOrigin, 5'000, 600},
    {"mixed_magnitudes", MixedMagnitudes, 5'000, 80},
    {"half_degenerate", HalfDegenerate, 5'000, 600},
    {"all_degenerate", AllDegenerate, 5'000, 600},
    {"flat_grid", FlatGrid, 5'000, 600},
    {"voxels", Voxels, 5'000, 64},
    {"coplanar_overlap", CoplanarOverlap, 2'000, 200},
    {"t_junctions", TJunctions, 5'000, 200},
    {"geometric_series", GeometricSeries, 120, 60},
    {"sphere", UnitSphere, 5'000, 600},
    {"distant", Distant, 5'000, 600},
    {"needle_fan", NeedleFan, 500, 100},
    {"ulp_cracks", UlpCracks, 5'000, 200},
    {"ulp_layers", UlpLayers, 100, 40},
    {"any_bits", AnyBits, 300, 60},
    {"single", Single, 1, 1},
    {"empty", Empty, 0, 0},
};

}  // namespace

std::span<const PathologicalScene> PathologicalScenes() { return kScenes; }

}  // namespace deltaray
