// On which side of a line a point of the plane lies, decided exactly.

#ifndef SERVER_MESH_ORIENTATION_H_
#define SERVER_MESH_ORIENTATION_H_

namespace deltaray {

// A point of the plane. Coordinates are finite.
struct Point2 {
  float x = 0, y = 0;
  friend bool operator==(const Point2&, const Point2&) = default;
};

// 1 where a, b, c turn to the left, -1 where they turn to the right, 0 where they are on one line.
int Orientation(Point2 a, Point2 b, Point2 c);

}  // namespace deltaray

#endif  // SERVER_MESH_ORIENTATION_H_
