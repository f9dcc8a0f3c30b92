// Any query, in a tree whose leaves are being recorded.

#if defined(SERVER_TREE_RECORDING_QUERY_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SERVER_TREE_RECORDING_QUERY_INL_H_
#undef SERVER_TREE_RECORDING_QUERY_INL_H_
#else
#define SERVER_TREE_RECORDING_QUERY_INL_H_
#endif

#include <cstdint>

#include "hwy/highway.h"
#include "server/tree/leaf_lanes-inl.h"
#include "server/tree/leaf_recorder.h"
#include "server/tree/packet_rays-inl.h"
#include "server/tree/ray_slot.h"
#include "server/tree/wide_node.h"

HWY_BEFORE_NAMESPACE();
namespace deltaray {
namespace HWY_NAMESPACE {

// Does as `Query`, and tells this thread's LeafRecorder of each leaf that is tested. A type of its own, so that nothing
// is asked of the recorder where there is none.
template <typename Query>
class RecordingQuery {
 public:
  struct Test : Query::Test {
    template <typename Rays, typename Triangles>
    HWY_ATTR static HWY_INLINE auto Start(const Rays& rays, const Triangles& triangles) {
      LeafRecorder::current()->Record(triangles.leaf.columns);
      return Query::Test::Start(rays, triangles);
    }
  };
  using First = typename Query::First;
  using FirstOfRays = typename Query::FirstOfRays;
  static constexpr bool kOrdered = Query::kOrdered;

  explicit RecordingQuery(Query& query) : query_(query) {}

  HWY_ATTR HWY_INLINE void Take(RaySlot& ray, const LeafView& leaf, uint32_t first, const First& start) {
    query_.Take(ray, leaf, first, start);
  }
  HWY_ATTR HWY_INLINE void TakeOne(PacketRays& packet, size_t i, ChildRef ref, const LeafView& leaf, uint32_t first,
                                   const First& start) {
    query_.TakeOne(packet, i, ref, leaf, first, start);
  }
  HWY_ATTR HWY_INLINE void TakeRays(PacketRays& packet, size_t first, ChildRef ref, const OneTriangle& triangle,
                                    const FirstOfRays& start) {
    query_.TakeRays(packet, first, ref, triangle, start);
  }
  HWY_ATTR void EndRays(PacketRays& packet) { query_.EndRays(packet); }
  void Miss(uint32_t ray) { query_.Miss(ray); }
  HWY_ATTR void End(RaySlot& ray) { query_.End(ray); }

 private:
  Query& query_;
};

}  // namespace HWY_NAMESPACE
}  // namespace deltaray
HWY_AFTER_NAMESPACE();

#endif  // SERVER_TREE_RECORDING_QUERY_INL_H_
