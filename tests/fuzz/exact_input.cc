#include "tests/fuzz/exact_input.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <utility>

#include "tests/fuzz/byte_reader.h"

namespace deltaray {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr size_t kMaxVertices = 32, kMaxTriangles = 48, kMaxCopies = 6;
constexpr size_t kMaxGroups = 3;
// More than a packet and a stream together.
constexpr int kGroupRays = 49;

// Numbers at which arithmetic is exact, on the verge of it, or at an end of float's range.
constexpr float kCoordinates[] = {0,
                                  -0.0f,
                                  1,
                                  -1,
                                  2,
                                  3,
                                  0.5f,
                                  -0.5f,
                                  0.25f,
                                  0.75f,
                                  4,
                                  7,
                                  -3,
                                  0.1f,
                                  1 / 3.0f,
                                  0x1.000002p0f,
                                  1 - 0x1p-24f,
                                  0x1p-12f,
                                  0x1p-24f,
                                  1 + 0x1p-12f,
                                  0x1p12f,
                                  0x1p24f,
                                  1e-20f,
                                  0x1p-126f,
                                  0x1p-149f,
                                  -0x1p-149f,
                                  1e30f,
                                  0x1.fffffep127f};
constexpr float kSpeeds[] = {1, 1, 1, 1, 0.5f, 0.3f, 0x1p-20f, 0x1p20f, 0x1p-80f, 0x1p-126f, 0x1p100f, -1};
// Rays are aimed so that t = 1 at the target.
constexpr float kEnds[] = {0, -0.0f, 1, 1 - 0x1p-24f, 1 + 0x1p-23f, 0.5f, 2, -1, kInfinity, -kInfinity, 0x1p-149f};

// Infinity and NaN lose the greatest bit of their exponent.
float Finite(float x) { return std::isfinite(x) ? x : std::bit_cast<float>(std::bit_cast<uint32_t>(x) & 0xBFFFFFFF); }
Vec3f Finite(Vec3f v) { return {Finite(v.x), Finite(v.y), Finite(v.z)}; }

// The float so many steps from `x`, its bits taken as a number: from 0 through the subnormal ones.
float Step(float x, int steps) {
  return Finite(std::bit_cast<float>(std::bit_cast<uint32_t>(x) + static_cast<uint32_t>(steps)));
}

class InputReader {
 public:
  explicit InputReader(std::span<const uint8_t> bytes) : bytes_(bytes) {}

  ExactInput Read() {
    ReadTree();
    ReadQuery();
    scale_ = std::ldexp(1.0f, bytes_.Signed());
    ReadMesh();
    while (!bytes_.AtEnd() && input_.rays.size() < kMaxGroups * kGroupRays) ReadRays();
    return std::move(input_);
  }

 private:
  void ReadTree() {
    constexpr Builder kBuilders[] = {Builder::kHybrid, Builder::kHybrid, Builder::kKdTree,
                                     Builder::kBvh,    Builder::kSbvh,   Builder::kTang2015};
    constexpr Preset kPresets[] = {Preset::kBalanced, Preset::kFast, Preset::kBest};
    constexpr uint32_t kDeltas[] = {0, 1, 2, 3, 4, 8, 16, 32, 64, 4096};
    constexpr double kAlphas[] = {0.6, 0, 0.25, 1};
    constexpr double kGates[] = {1e-3, 0, 1e-5, 1};
    constexpr double kBudgets[] = {0.5, 0, 1, 16};
    const Builder builder = bytes_.OneOf(kBuilders);
    Config& config = input_.config;
    config = MakeConfig(builder, bytes_.OneOf(kPresets));
    config.lazy = builder == Builder::kHybrid && bytes_.Below(4) == 3;
    // 0: the preset's values.
    if (const uint32_t delta = bytes_.OneOf(kDeltas); delta != 0) {
      config.delta = delta;
      config.alpha = bytes_.OneOf(kAlphas);
      config.spatial_split_gate = bytes_.OneOf(kGates);
      config.duplication_budget = bytes_.OneOf(kBudgets);
      config.max_leaf_size = 1 + bytes_.Below(16);
    }
    const std::vector<SimdTarget>& targets = SupportedSimdTargets();
    // Counted from the widest, so that 0 is what is used most.
    input_.target = targets[targets.size() - 1 - bytes_.Below(targets.size())];
  }

  void ReadQuery() {
    constexpr Traversal kTraversals[] = {Traversal::kAuto, Traversal::kSingle, Traversal::kBatch, Traversal::kPacket,
                                         Traversal::kStream};
    constexpr Culling kCullings[] = {Culling::kNone, Culling::kBack, Culling::kFront};
    constexpr uint32_t kCaps[] = {std::numeric_limits<uint32_t>::max(), 1, 2, 5};
    input_.options.traversal = bytes_.OneOf(kTraversals);
    input_.options.culling = bytes_.OneOf(kCullings);
    input_.options.max_hits_per_ray = bytes_.OneOf(kCaps);
  }

  // One of the table, or one of about the same size with which arithmetic rounds, both scaled; or any bits.
  float Coordinate() {
    const uint8_t choice = bytes_.Byte();
    if (choice >= 224) return Finite(bytes_.Float());
    if (choice < 140) return Finite(kCoordinates[choice % std::size(kCoordinates)] * scale_);
    const float magnitude = std::ldexp(1 + static_cast<float>(bytes_.Word() >> 9) * 0x1p-23f, choice / 2 % 4 - 2);
    return Finite((choice % 2 == 0 ? magnitude : -magnitude) * scale_);
  }
  Vec3f Coordinates() {
    const float x = Coordinate(), y = Coordinate(), z = Coordinate();
    return {x, y, z};
  }

  Vec3f& PickVertex() { return input_.mesh.positions[bytes_.Below(input_.mesh.positions.size())]; }

  // A new point, or one that is nearly or exactly in line or in plane with vertices that there are.
  Vec3f Point() {
    if (input_.mesh.positions.empty()) return Coordinates();
    switch (bytes_.Below(8)) {
      case 0: {
        const Vec3f a = PickVertex(), b = PickVertex();
        return Finite(0.5f * a + 0.5f * b);
      }
      case 1: {
        const Vec3f a = PickVertex(), b = PickVertex(), c = PickVertex();
        return Finite(a + Finite(b - c));
      }
      case 2: {
        Vec3f near = PickVertex();
        for (int axis = 0; axis < 3; ++axis) near[axis] = Step(near[axis], bytes_.Signed());
        return near;
      }
      case 3: {
        Vec3f beside = PickVertex();
        beside[static_cast<int>(bytes_.Below(3))] = Coordinate();
        return beside;
      }
      case 4:
        return PickVertex();
      default:
        return Coordinates();
    }
  }

  void ReadMesh() {
    TriangleMesh& mesh = input_.mesh;
    const size_t vertices = 1 + bytes_.Below(kMaxVertices), triangles = bytes_.Below(kMaxTriangles + 1);
    const size_t copies = 1 + bytes_.Below(kMaxCopies);
    for (size_t i = 0; i < vertices; ++i) mesh.positions.push_back(Point());
    for (size_t i = 0; i < triangles; ++i) {
      const uint32_t a = bytes_.Below(vertices), b = bytes_.Below(vertices), c = bytes_.Below(vertices);
      mesh.indices.push_back({a, b, c});
    }
    // All of it again, moved: enough for trees of several levels.
    for (size_t copy = 1; copy < copies; ++copy) {
      const Vec3f offset = Coordinates();
      for (size_t i = 0; i < vertices; ++i) mesh.positions.push_back(Finite(mesh.positions[i] + offset));
      for (size_t i = 0; i < triangles; ++i) {
        const auto [a, b, c] = mesh.indices[i];
        const auto first = static_cast<uint32_t>(copy * vertices);
        mesh.indices.push_back({a + first, b + first, c + first});
      }
    }
    mesh.face_count = mesh.indices.size();
  }

  float End(float usual) {
    const uint8_t choice = bytes_.Byte();
    if (choice < 128) return usual;
    if (choice < 224) return kEnds[choice % std::size(kEnds)];
    const float any = bytes_.Float();
    return std::isnan(any) ? Finite(any) : any;
  }

  uint32_t Excluded() {
    const uint8_t choice = bytes_.Byte();
    if (choice < 192 || input_.mesh.indices.empty()) return kNoPrimitive;
    return choice < 240 ? choice % static_cast<uint32_t>(input_.mesh.indices.size()) : bytes_.Word();
  }

  Ray FirstRay() {
    Ray ray;
    ray.origin = Point();
    switch (bytes_.Below(8)) {
      case 0:
        ray.direction = Coordinates();
        break;
      case 1:
        for (int axis = 0; axis < 3; ++axis) ray.direction[axis] = bytes_.Below(2) == 0 ? 0.0f : -0.0f;
        ray.direction[static_cast<int>(bytes_.Below(3))] = Coordinate();
        break;
      case 2: {
        // Along an edge, and so in the planes of its triangles where the origin is a vertex.
        const Vec3f a = PickVertex(), b = PickVertex();
        ray.direction = Finite(a - b);
        break;
      }
      default:
        ray.direction = Finite(Point() - ray.origin);
    }
    ray.direction = Finite(bytes_.OneOf(kSpeeds) * ray.direction);
    ray.t_min = End(0);
    ray.t_max = End(kInfinity);
    ray.excluded_primitive = Excluded();
    return ray;
  }

  // A ray and its neighbours.
  void ReadRays() {
    const Ray first = FirstRay();
    const uint32_t kind = bytes_.Below(6);
    const float spread = std::ldexp(1.0f, -static_cast<int>(bytes_.Below(32)));
    const int stride = bytes_.Signed();
    const auto vertices = static_cast<int>(input_.mesh.positions.size());
    const auto triangles = static_cast<uint32_t>(input_.mesh.indices.size());
    for (int i = 0; i < kGroupRays; ++i) {
      Ray ray = first;
      const int column = i % 7 - 3, row = i / 7 - 3;
      switch (kind) {
        case 0:  // directions of a camera
        case 1:  // origins of one
        {
          Vec3f& moved = kind == 0 ? ray.direction : ray.origin;
          const float step = spread * std::max({std::abs(moved.x), std::abs(moved.y), std::abs(moved.z)});
          moved.x = Finite(moved.x + static_cast<float>(column) * step);
          moved.y = Finite(moved.y + static_cast<float>(row) * step);
          break;
        }
        case 2:  // a few steps of float away
          ray.direction[i % 3] = Step(ray.direction[i % 3], column * stride);
          ray.origin[i / 7 % 3] = Step(ray.origin[i / 7 % 3], row);
          break;
        case 3:  // from one point to all vertices
          ray.direction = Finite(input_.mesh.positions[static_cast<size_t>(i % vertices)] - ray.origin);
          break;
        case 4:  // the same, each without another triangle
          if (triangles != 0) ray.excluded_primitive = static_cast<uint32_t>(i) % triangles;
          break;
        default:  // ends that move past each other
          ray.t_min = Step(1, column * stride);
          ray.t_max = Step(1, row * stride);
      }
      input_.rays.push_back(ray);
    }
  }

  ByteReader bytes_;
  ExactInput input_;
  float scale_ = 1;
};

}  // namespace

ExactInput ReadExactInput(std::span<const uint8_t> bytes) { return InputReader(bytes).Read(); }

}  // namespace deltaray
