#include "server/mesh/triangulate.h"

#include <algorithm>
#include <cmath>

namespace deltaray {

bool Triangulator::Append(std::span<const uint32_t> corners, Triangles* triangles) {
  corners_ = corners;
  const uint32_t n = corners.size();
  const size_t begin = triangles->size();
  if (n > 3) {
    Project();
    if (n == 4 && SplitQuad(triangles)) return true;
    FindTurns();
    const bool convex = std::all_of(turns_.begin(), turns_.end(), [](int8_t turn) { return turn > 0; });
    const bool has_area = std::any_of(turns_.begin(), turns_.end(), [](int8_t turn) { return turn > 0; });
    if (!has_area || !TurnsOnce() || (!convex && !ClipEars(triangles))) {
      triangles->resize(begin);
      for (uint32_t i = 2; i < n; ++i) Emit(0, i - 1, i, triangles);
      return false;
    }
    if (!convex) return true;
  }
  for (uint32_t i = 2; i < n; ++i) Emit(0, i - 1, i, triangles);
  return true;
}

void Triangulator::Project() {
  const uint32_t n = corners_.size();
  const Vec3d origin = static_cast<Vec3d>(positions_[corners_[0]]);
  Vec3d normal, previous;
  for (uint32_t i = 1; i < n; ++i) {
    const Vec3d current = static_cast<Vec3d>(positions_[corners_[i]]) - origin;
    normal = normal + Cross(previous, current);
    previous = current;
  }
  int axis = 0;
  for (int i = 1; i < 3; ++i) {
    if (std::abs(normal[i]) > std::abs(normal[axis])) axis = i;
  }
  // From where the polygon turns to the left.
  const int x = (axis + (normal[axis] >= 0 ? 1 : 2)) % 3, y = 3 - axis - x;
  points_.resize(n);
  for (uint32_t i = 0; i < n; ++i) points_[i] = {positions_[corners_[i]][x], positions_[corners_[i]][y]};
}

int Triangulator::Turn(uint32_t corner) const {
  return Orientation(points_[previous_[corner]], points_[corner], points_[next_[corner]]);
}

void Triangulator::FindTurns() {
  const uint32_t n = corners_.size();
  next_.resize(n);
  previous_.resize(n);
  turns_.resize(n);
  for (uint32_t i = 0; i < n; ++i) {
    next_[i] = i + 1 < n ? i + 1 : 0;
    previous_[i] = i > 0 ? i - 1 : n - 1;
  }
  for (uint32_t i = 0; i < n; ++i) turns_[i] = Turn(i);
}

bool Triangulator::TurnsOnce() const {
  const auto is_upward = [](Point2 a, Point2 b) { return b.y > a.y || (b.y == a.y && b.x > a.x); };
  const uint32_t n = points_.size();
  uint32_t last = n - 1;
  while (last > 0 && points_[last] == points_[0]) --last;
  Point2 from = points_[last], at = points_[0];
  int rounds = 0;
  for (uint32_t i = 1; i <= n; ++i) {
    const Point2 to = points_[i % n];
    if (to == at) continue;
    const int turn = Orientation(from, at, to);
    const bool before = is_upward(from, at), after = is_upward(at, to);
    // Going straight back may be a turn to either side.
    if (turn == 0 && before != after) return true;
    // Directions from +x to before -x are upward; the rounds are counted as they pass +x.
    if (turn > 0 && !before && after) ++rounds;
    if (turn < 0 && before && !after) --rounds;
    from = at;
    at = to;
  }
  return rounds == 1;
}

bool Triangulator::SplitQuad(Triangles* triangles) const {
  const auto turn = [&](int a, int b, int c) { return Orientation(points_[a], points_[b], points_[c]) > 0; };
  if (turn(0, 1, 2) && turn(0, 2, 3)) {
    Emit(0, 1, 2, triangles);
    Emit(0, 2, 3, triangles);
    return true;
  }
  if (turn(1, 2, 3) && turn(1, 3, 0)) {
    Emit(1, 2, 3, triangles);
    Emit(1, 3, 0, triangles);
    return true;
  }
  return false;
}

bool Triangulator::ClipEars(Triangles* triangles) {
  const uint32_t n = corners_.size();
  clipped_.assign(n, false);
  queued_.assign(n, false);
  queue_.clear();
  flat_.clear();
  std::vector<uint32_t> obstacles;
  for (uint32_t i = 0; i < n; ++i) {
    if (turns_[i] > 0) Enqueue(i);
    if (turns_[i] <= 0) obstacles.push_back(i);
    if (turns_[i] == 0) flat_.push_back(i);
  }
  obstacles_.Build(points_, obstacles);

  // Clip proper ears while there are any. In a simple polygon that does all, since clipping an ear makes ears of its
  // neighbours only. Where edges touch it may come to a stop: then clip corners without a turn, which have no area; and
  // at last ears that obstacles touch but are not inside of.
  bool closed = true;
  uint32_t left = n, last = 0;
  for (size_t head = 0; left > 3;) {
    uint32_t corner;
    if (head < queue_.size()) {
      corner = queue_[head++];
      queued_[corner] = false;
      if (clipped_[corner] || turns_[corner] <= 0 ||
          obstacles_.AnyIn(points_[previous_[corner]], points_[corner], points_[next_[corner]], closed)) {
        continue;
      }
    } else if (!flat_.empty()) {
      corner = flat_.back();
      flat_.pop_back();
      if (clipped_[corner] || turns_[corner] != 0) continue;
    } else if (closed) {
      closed = false;
      for (uint32_t i = 0; i < n; ++i) {
        if (!clipped_[i] && turns_[i] > 0) Enqueue(i);
      }
      continue;
    } else {
      return false;
    }
    last = next_[corner];
    Clip(corner, triangles);
    --left;
  }
  Emit(previous_[last], last, next_[last], triangles);
  // What the triangles cover, counted with their signs, is what the polygon goes round. All others turn to the left or
  // have no area; if the last one does too, none covers what another does.
  return turns_[last] >= 0;
}

void Triangulator::Clip(uint32_t corner, Triangles* triangles) {
  const uint32_t before = previous_[corner], after = next_[corner];
  Emit(before, corner, after, triangles);
  clipped_[corner] = true;
  if (obstacles_.Contains(corner)) obstacles_.Remove(corner);
  next_[before] = after;
  previous_[after] = before;
  Update(before);
  Update(after);
}

void Triangulator::Update(uint32_t corner) {
  turns_[corner] = Turn(corner);
  if (turns_[corner] == 0) flat_.push_back(corner);
  if (turns_[corner] <= 0) return;
  if (obstacles_.Contains(corner)) obstacles_.Remove(corner);
  Enqueue(corner);
}

void Triangulator::Enqueue(uint32_t corner) {
  if (queued_[corner]) return;
  queued_[corner] = true;
  queue_.push_back(corner);
}

}  // namespace deltaray
