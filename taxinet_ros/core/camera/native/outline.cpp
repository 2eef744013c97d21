#include "outline.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace pixels {
namespace {

using Point = std::array<double, 3>;

constexpr double kFractions = 16.0;

struct Pinhole {
    double focal_u, focal_v, centre_u, centre_v, width, height, nearest_m;

    // Pixel times depth.
    std::array<double, 2> scaled(const Point &point) const {
        return {focal_u * point[0] + centre_u * point[2], focal_v * point[1] + centre_v * point[2]};
    }

    // Whether a convex part is not completely outside one of the five planes of the view. Also
    // valid if some of its corners are behind the camera.
    bool may_see(const std::vector<Point> &part) const {
        std::array<double, 5> most;
        most.fill(-std::numeric_limits<double>::infinity());
        for (const Point &point : part) {
            const auto [u, v] = scaled(point);
            const std::array<double, 5> inside{u, v, width * point[2] - u, height * point[2] - v,
                                               point[2] - nearest_m};
            for (std::size_t side = 0; side < most.size(); ++side) {
                most[side] = std::max(most[side], inside[side]);
            }
        }
        return std::all_of(most.begin(), most.end(), [](double side) { return side > 0; });
    }
};

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

std::vector<Corners> outlines(const Doubles &corners, const std::vector<int> &starts,
                              const Doubles &intrinsics, const std::array<int, 2> &size,
                              double nearest_m, double farthest_px) {
    require(corners.ndim() == 2 && corners.shape(1) == 3, "corners are (N, 3)");
    require(intrinsics.ndim() == 2 && intrinsics.shape(0) == 3 && intrinsics.shape(1) == 3,
            "a camera matrix is (3, 3)");
    const int count = static_cast<int>(corners.shape(0));
    require(std::is_sorted(starts.begin(), starts.end()) &&
                (starts.empty() || (starts.front() >= 0 && starts.back() <= count)),
            "parts start one after the other, within the corners");
    const Pinhole pinhole{intrinsics.at(0, 0), intrinsics.at(1, 1),
                          intrinsics.at(0, 2), intrinsics.at(1, 2),
                          static_cast<double>(size[1]), static_cast<double>(size[0]), nearest_m};
    std::vector<Corners> found;
    for (std::size_t i = 0; i < starts.size(); ++i) {
        std::vector<Point> part;
        const int end = i + 1 < starts.size() ? starts[i + 1] : count;
        for (int j = starts[i]; j < end; ++j) {
            part.push_back({corners.at(j, 0), corners.at(j, 1), corners.at(j, 2)});
        }
        if (!pinhole.may_see(part)) {
            continue;
        }
        const std::vector<Point> before = cut(part, nearest_m);
        Corners outline({static_cast<py::ssize_t>(before.size()), py::ssize_t{2}});
        for (std::size_t j = 0; j < before.size(); ++j) {
            const auto scaled = pinhole.scaled(before[j]);
            for (int axis = 0; axis < 2; ++axis) {
                const double pixel =
                    std::clamp(scaled[axis] / before[j][2], -farthest_px, farthest_px);
                *outline.mutable_data(j, axis) =
                    static_cast<std::int32_t>(std::nearbyint(pixel * kFractions));
            }
        }
        found.push_back(outline);
    }
    return found;
}

}  // namespace pixels
