#include "outline.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace pixels {
namespace {

// Clips a convex part at the near plane: returns the points in front of it and, for every pair on
// both sides, the intersection of its line with the plane. The hull of these is the clipped part.
std::vector<Point> cut(const std::vector<Point> &part, double nearest_m) {
    std::vector<Point> ahead, behind;
    for (const Point &point : part) {
        (point[2] >= nearest_m ? ahead : behind).push_back(point);
    }
    std::vector<Point> all = ahead;
    for (const Point &near : behind) {
        for (const Point &far : ahead) {
            const double share = (nearest_m - near[2]) / (far[2] - near[2]);
            Point pierced;
            for (std::size_t axis = 0; axis < pierced.size(); ++axis) {
                pierced[axis] = near[axis] + share * (far[axis] - near[axis]);
            }
            all.push_back(pierced);
        }
    }
    return all;
}

}  // namespace

std::vector<Point> points_of(const Doubles &corners, const std::vector<int> &starts) {
    require(corners.ndim() == 2 && corners.shape(1) == 3, "corners are (N, 3)");
    const int count = static_cast<int>(corners.shape(0));
    require(std::is_sorted(starts.begin(), starts.end()) &&
                (starts.empty() || (starts.front() >= 0 && starts.back() <= count)),
            "parts start one after the other, within the corners");
    std::vector<Point> points;
    for (int i = 0; i < count; ++i) {
        points.push_back({corners.at(i, 0), corners.at(i, 1), corners.at(i, 2)});
    }
    return points;
}

Pinhole::Pinhole(const Doubles &intrinsics, const std::array<int, 2> &size, double nearest_m,
                 double farthest_px)
    : width_(size[1]), height_(size[0]), nearest_m_(nearest_m), farthest_px_(farthest_px) {
    const Matrix matrix = matrix_of(intrinsics, "a camera matrix is (3, 3)");
    focal_u_ = matrix[0][0];
    focal_v_ = matrix[1][1];
    centre_u_ = matrix[0][2];
    centre_v_ = matrix[1][2];
}

// Pixel times depth.
std::array<double, 2> Pinhole::scaled(const Point &point) const {
    return {focal_u_ * point[0] + centre_u_ * point[2], focal_v_ * point[1] + centre_v_ * point[2]};
}

// Whether a convex part is not completely outside one of the five planes of the view. Also valid if
// some of its corners are behind the camera.
bool Pinhole::may_see(const std::vector<Point> &part) const {
    std::array<double, 5> most;
    most.fill(-std::numeric_limits<double>::infinity());
    for (const Point &point : part) {
        const auto [u, v] = scaled(point);
        const std::array<double, 5> inside{u, v, width_ * point[2] - u, height_ * point[2] - v,
                                           point[2] - nearest_m_};
        for (std::size_t side = 0; side < most.size(); ++side) {
            most[side] = std::max(most[side], inside[side]);
        }
    }
    return std::all_of(most.begin(), most.end(), [](double side) { return side > 0; });
}

Corners Pinhole::outline(const std::vector<Point> &part) const {
    const std::vector<Point> before = cut(part, nearest_m_);
    Corners outline({static_cast<py::ssize_t>(before.size()), py::ssize_t{2}});
    for (std::size_t i = 0; i < before.size(); ++i) {
        const auto pixel_times_depth = scaled(before[i]);
        for (int axis = 0; axis < 2; ++axis) {
            const double pixel =
                std::clamp(pixel_times_depth[axis] / before[i][2], -farthest_px_, farthest_px_);
            *outline.mutable_data(i, axis) =
                static_cast<std::int32_t>(std::nearbyint(pixel * (1 << kFractionBits)));
        }
    }
    return outline;
}

std::vector<Corners> Pinhole::outlines(const std::vector<Point> &corners,
                                       const std::vector<int> &starts) const {
    std::vector<Corners> found;
    for (std::size_t i = 0; i < starts.size(); ++i) {
        const auto end = i + 1 < starts.size() ? corners.begin() + starts[i + 1] : corners.end();
        const std::vector<Point> part(corners.begin() + starts[i], end);
        if (may_see(part)) {
            found.push_back(outline(part));
        }
    }
    return found;
}

}  // namespace pixels
