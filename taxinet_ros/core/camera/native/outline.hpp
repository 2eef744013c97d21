// Projection of the convex parts of a body; used by objects.py and for shadows.

#pragma once

#include <array>
#include <vector>

#include "common.hpp"

namespace pixels {

using Corners = py::array_t<std::int32_t>;
using Point = std::array<double, 3>;

// Corners are in sixteenths of a pixel.
constexpr int kFractionBits = 4;

// A camera that sees the convex parts of a body.
//
// Intrinsics is the camera matrix (3, 3), size the image height and width [px]. Parts are clipped at
// depth `nearest_m`, and coordinates clamped to `farthest_px`.
class Pinhole {
  public:
    Pinhole(const Doubles &intrinsics, const std::array<int, 2> &size, double nearest_m,
            double farthest_px);

    // For each part that may touch the image, the corners of its outline, or points inside it,
    // (n, 2), in sixteenths of a pixel.
    //
    // Corners are in the camera's optical frame; starts are the first corners of the parts, in
    // order.
    std::vector<Corners> outlines(const std::vector<Point> &corners,
                                  const std::vector<int> &starts) const;

  private:
    std::array<double, 2> scaled(const Point &point) const;
    bool may_see(const std::vector<Point> &part) const;
    Corners outline(const std::vector<Point> &part) const;

    double focal_u_, focal_v_, centre_u_, centre_v_, width_, height_, nearest_m_, farthest_px_;
};

// Corners (N, 3) of parts that start one after the other.
std::vector<Point> points_of(const Doubles &corners, const std::vector<int> &starts);

}  // namespace pixels
