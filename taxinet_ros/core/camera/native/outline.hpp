// Projection of the convex parts and faces of a body; used by objects.py and for shadows.

#pragma once

#include <array>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "common.hpp"

namespace pixels {

using Corners = py::array_t<std::int32_t>;
using Point = std::array<double, 3>;

// Place (x, y) [m] and heading [rad] in `map`.
using Pose = std::array<double, 3>;

// Pixels (u, v).
using Polygon = std::vector<std::array<double, 2>>;

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

    // Rows and columns of the image within a margin of polygons, how many times finer these are
    // drawn, and their corners there, in sixteenths of a finer pixel.
    using Drawing = std::tuple<py::slice, py::slice, int, std::vector<Corners>>;

    // Outlines of the convex parts of what stands or lies on the ground, as they are cast on it by
    // a matrix (3, 3) for points in `map`. Nothing if they are not in view.
    //
    // Corners (N, 3) are in its own frame. The camera has a rotation from `map` to its optical
    // frame (3, 3), and a place in `map`.
    std::optional<Drawing> cover(const Doubles &corners, const std::vector<int> &starts,
                                 const Pose &pose, const Doubles &cast, const Doubles &to_optical,
                                 const Point &camera, int margin_px) const;

    // Flat faces that look at the camera, from far to near, and the number of each.
    //
    // `about` has three rows for each face: its middle, its normal, and the point whose distance
    // counts; of those with the same distance the first is the farthest.
    std::optional<std::pair<Drawing, std::vector<int>>> faces(
        const Doubles &corners, const std::vector<int> &starts, const Doubles &about,
        const Pose &pose, const Doubles &to_optical, const Point &camera) const;

  private:
    std::array<double, 2> scaled(const Point &point) const;
    bool may_see(const std::vector<Point> &part) const;
    Corners outline(const std::vector<Point> &part) const;
    Polygon face(const std::vector<Point> &corners) const;
    Polygon beside(Polygon polygon) const;
    std::optional<Drawing> drawing(const std::vector<Polygon> &polygons, int margin_px) const;

    double focal_u_, focal_v_, centre_u_, centre_v_, width_, height_, nearest_m_, farthest_px_;
};

// Corners (N, 3) of parts that start one after the other.
std::vector<Point> points_of(const Doubles &corners, const std::vector<int> &starts);

// Turns points, and then shifts them.
std::vector<Point> placed(const Matrix &turn, const Point &shift, const std::vector<Point> &points);

py::slice slice(int first, int end);

}  // namespace pixels
