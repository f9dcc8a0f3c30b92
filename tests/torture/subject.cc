#include "tests/torture/subject.h"

#include <cstring>
#include <utility>

#include "server/mesh/canonical.h"
#include "server/tree/brute_force.h"
#include "tests/scenes/made.h"
#include "tests/scenes/rays.h"

namespace deltaray {

bool Subject::Accepts(const v1::HitBatch& hits, size_t first) const {
  const size_t count = hits.ray_count();
  return first + count <= t.size() && hits.t().size() == count * sizeof(float) &&
         hits.primitive_id().size() == count * sizeof(uint32_t) &&
         std::memcmp(hits.t().data(), t.data() + first, hits.t().size()) == 0 &&
         std::memcmp(hits.primitive_id().data(), primitive_ids.data() + first, hits.primitive_id().size()) == 0;
}

namespace {

// Chords of the box that all meshes fill.
std::vector<Ray> MakeRays(uint32_t count) {
  Bounds box;
  box.Extend(Vec3f{0, 0, 0});
  box.Extend(Vec3f{1, 1, 1});
  return ChordRays(box, count, /*seed=*/1);
}

}  // namespace

Subjects::Subjects(int count, uint32_t ray_count) : rays(MakeRays(ray_count)) {
  const std::vector<Ray> asked = MakeRays(ray_count);
  for (int i = 0; i < count; ++i) {
    auto subject = std::make_unique<Subject>();
    // The last one takes several messages to upload.
    subject->mesh = Soup(i + 1 < count ? 1'000 + 1'500 * i : 50'000, /*seed=*/100 + i);
    subject->id = MeshId(subject->mesh);
    std::vector<Hit> hits(asked.size());
    BruteForce(subject->mesh.triangles()).ClosestHits(asked, {}, hits);
    for (const Hit& hit : hits) {
      subject->t.push_back(hit.t);
      subject->primitive_ids.push_back(hit.primitive);
    }
    meshes.push_back(std::move(subject));
  }
}

}  // namespace deltaray
