// Shadow of a body on level ground; used by airframe.py.

#pragma once

#include <optional>
#include <tuple>

#include "outline.hpp"

namespace pixels {

// Casts the shadows of the convex parts of a body.
class Shadow {
  public:
    // Corners (N, 3) in the body frame, and the first corner of each part, in order; the unit
    // vector towards the sun in `map`; the width of the shadows' soft edge [px].
    Shadow(const Doubles &corners, std::vector<int> starts, const Point &sun,
           const Doubles &intrinsics, const std::array<int, 2> &size, double nearest_m,
           double farthest_px, int edge_px);

    // Slices of the rows and columns of the image that the shadows may touch, and their outlines as
    // of Pinhole; nothing if they are not in view. Arguments are the rotation from the body frame
    // to `map` (3, 3), the body's place in `map`, the rotation from `map` to the camera's optical
    // frame (3, 3) and the camera's place in `map`.
    using Seen = std::tuple<py::slice, py::slice, std::vector<Corners>>;
    std::optional<Seen> outlines(const Doubles &body, const Point &place,
                                 const Doubles &to_optical, const Point &camera) const;

  private:
    std::vector<Point> corners_;
    std::vector<int> starts_;
    Matrix flatten_;
    Pinhole pinhole_;
    std::array<int, 2> size_;
    int edge_px_;
};

}  // namespace pixels
