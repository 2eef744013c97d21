#include "outline.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace pixels {
namespace {

// Farther beside the picture polygons are cut off: drawing takes coordinates of 32 bits.
constexpr double kBesidePx = 4000.0;

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

// What of a convex polygon is kept (Sutherland and Hodgman). An edge between a corner that is kept and
// one that is not is cut at a share of its length.
template <typename Corner, typename Keeps, typename Share>
std::vector<Corner> clip(const std::vector<Corner> &polygon, Keeps keeps, Share share_of) {
    std::vector<Corner> kept;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
        const Corner &here = polygon[i], &there = polygon[(i + 1) % polygon.size()];
        if (keeps(here)) {
            kept.push_back(here);
        }
        if (keeps(here) != keeps(there)) {
            const double share = share_of(here, there);
            Corner &pierced = kept.emplace_back();
            for (std::size_t axis = 0; axis < pierced.size(); ++axis) {
                pierced[axis] = here[axis] + share * (there[axis] - here[axis]);
            }
        }
    }
    return kept;
}

// Rounded as OpenBLAS and numpy do: see pose.hpp.
FOR_EACH_PROCESSOR void place_points(const Matrix &turn, const Point &shift, const Point *points,
                                     int count, Point *placed) {
    for (int i = 0; i < count; ++i) {
        for (int j = 0; j < 3; ++j) {
            const double sum = __builtin_fma(
                points[i][2], turn[j][2],
                __builtin_fma(points[i][1], turn[j][1], points[i][0] * turn[j][0]));
            placed[i][j] = sum + shift[j];
        }
    }
}

Matrix turn_of(const Pose &pose) {
    const double cos = std::cos(pose[2]), sin = std::sin(pose[2]);
    return {{{cos, -sin, 0.0}, {sin, cos, 0.0}, {0.0, 0.0, 1.0}}};
}

// Points in `map` in a camera's optical frame.
std::vector<Point> seen(std::vector<Point> points, const Doubles &to_optical, const Point &camera) {
    for (Point &point : points) {
        for (int axis = 0; axis < 3; ++axis) {
            point[axis] -= camera[axis];
        }
    }
    return placed(matrix_of(to_optical, "a rotation is (3, 3)"), {}, points);
}

// The hull of points, in pixels: Andrew's monotone chains, there and back.
Polygon hull(const Corners &outline) {
    std::vector<std::array<std::int64_t, 2>> points, chain;
    for (py::ssize_t i = 0; i < outline.shape(0); ++i) {
        points.push_back({*outline.data(i, 0), *outline.data(i, 1)});
    }
    std::sort(points.begin(), points.end());
    for (int way = 0; way < 2; ++way) {
        const std::size_t first = chain.size();
        for (const auto &[u, v] : points) {
            while (chain.size() > first + 1) {
                const auto &[au, av] = chain[chain.size() - 2];
                const auto &[bu, bv] = chain.back();
                if ((bu - au) * (v - av) - (bv - av) * (u - au) > 0) {
                    break;
                }
                chain.pop_back();
            }
            chain.push_back({u, v});
        }
        chain.pop_back();  // the other chain begins with it
        std::reverse(points.begin(), points.end());
    }
    Polygon found;
    for (const auto &[u, v] : chain) {
        found.push_back({static_cast<double>(u) / (1 << kFractionBits),
                         static_cast<double>(v) / (1 << kFractionBits)});
    }
    return found;
}

}  // namespace

py::slice slice(int first, int end) {
    return py::slice(py::int_(first), py::int_(end), py::none());
}

std::vector<Point> placed(const Matrix &turn, const Point &shift,
                          const std::vector<Point> &points) {
    std::vector<Point> found(points.size());
    place_points(turn, shift, points.data(), static_cast<int>(points.size()), found.data());
    return found;
}

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

std::optional<Pinhole::Drawing> Pinhole::cover(const Doubles &corners,
                                               const std::vector<int> &starts, const Pose &pose,
                                               const Doubles &cast, const Doubles &to_optical,
                                               const Point &camera, int margin_px) const {
    const std::vector<Point> points =
        placed(turn_of(pose), {pose[0], pose[1], 0.0}, points_of(corners, starts));
    const std::vector<Point> on_ground =
        placed(matrix_of(cast, "what casts points on the ground is (3, 3)"), {}, points);
    std::vector<Polygon> hulls;
    for (const Corners &part : outlines(seen(on_ground, to_optical, camera), starts)) {
        hulls.push_back(beside(hull(part)));
    }
    std::erase_if(hulls, [](const Polygon &one) { return one.empty(); });
    return drawing(hulls, margin_px);
}

std::optional<std::pair<Pinhole::Drawing, std::vector<int>>> Pinhole::faces(
    const Doubles &corners, const std::vector<int> &starts, const Doubles &about, const Pose &pose,
    const Doubles &to_optical, const Point &camera) const {
    const Matrix turn = turn_of(pose);
    const Point place{pose[0], pose[1], 0.0};
    const std::vector<Point> points =
        seen(placed(turn, place, points_of(corners, starts)), to_optical, camera);
    const std::vector<Point> turned = placed(turn, {}, points_of(about, {}));
    require(turned.size() == 3 * starts.size(), "there are three points about each face");
    std::vector<std::pair<double, int>> order;
    for (int i = 0; i < static_cast<int>(starts.size()); ++i) {
        const Point *of_face = &turned[3 * i];
        double facing = 0.0;
        for (int axis = 0; axis < 3; ++axis) {
            facing += of_face[1][axis] * (camera[axis] - place[axis] - of_face[0][axis]);
        }
        if (facing > 0) {
            order.emplace_back(-std::hypot(of_face[2][0] + place[0] - camera[0],
                                           of_face[2][1] + place[1] - camera[1]), i);
        }
    }
    std::sort(order.begin(), order.end());
    std::vector<Polygon> polygons;
    std::vector<int> numbers;
    for (const auto &[_, i] : order) {
        const bool last = i + 1 == static_cast<int>(starts.size());
        const auto end = last ? points.end() : points.begin() + starts[i + 1];
        Polygon polygon = face({points.begin() + starts[i], end});
        if (!polygon.empty()) {
            polygons.push_back(std::move(polygon));
            numbers.push_back(i);
        }
    }
    std::optional<Drawing> found = drawing(polygons, 1);
    if (!found) {
        return std::nullopt;
    }
    return std::pair{std::move(*found), std::move(numbers)};
}

// What of a flat convex polygon in the optical frame lies before the camera.
Polygon Pinhole::face(const std::vector<Point> &corners) const {
    const auto before = [this](const Point &at) { return at[2] >= nearest_m_; };
    const auto share = [this](const Point &here, const Point &there) {
        return (nearest_m_ - here[2]) / (there[2] - here[2]);
    };
    Polygon found;
    for (const Point &at : clip(corners, before, share)) {
        // Rounded as OpenBLAS does: see pose.hpp.
        const double u = std::fma(at[2], centre_u_, at[0] * focal_u_);
        const double v = std::fma(at[2], centre_v_, at[1] * focal_v_);
        found.push_back({std::clamp(u / at[2], -farthest_px_, farthest_px_),
                         std::clamp(v / at[2], -farthest_px_, farthest_px_)});
    }
    return beside(std::move(found));
}

// Cuts off what is far beside the picture, if anything is.
Polygon Pinhole::beside(Polygon polygon) const {
    const bool far = std::any_of(polygon.begin(), polygon.end(), [](const auto &at) {
        return std::max(std::abs(at[0]), std::abs(at[1])) > kBesidePx;
    });
    if (!far) {
        return polygon;
    }
    for (const int axis : {0, 1}) {
        for (const int sign : {1, -1}) {
            const double most = kBesidePx + (sign < 0 ? 0.0 : axis == 0 ? width_ : height_);
            const auto over = [=](const auto &at) { return sign * at[axis] - most; };
            polygon = clip(
                polygon, [&](const auto &at) { return over(at) <= 0; },
                [&](const auto &here, const auto &there) {
                    return over(here) / (over(here) - over(there));
                });
        }
    }
    return polygon;
}

// Nothing if no point is in view.
std::optional<Pinhole::Drawing> Pinhole::drawing(const std::vector<Polygon> &polygons,
                                                 int margin_px) const {
    std::array<int, 2> first, end;
    for (const int axis : {0, 1}) {
        double least = std::numeric_limits<double>::infinity(), most = -least;
        for (const Polygon &polygon : polygons) {
            for (const auto &at : polygon) {
                least = std::min(least, at[axis]);
                most = std::max(most, at[axis]);
            }
        }
        least = std::max(std::floor(least) - margin_px, 0.0);
        most = std::min(std::ceil(most) + margin_px + 1, axis == 0 ? width_ : height_);
        if (!(least < most)) {
            return std::nullopt;
        }
        first[axis] = static_cast<int>(least);
        end[axis] = static_cast<int>(most);
    }
    const int count = (end[0] - first[0]) * (end[1] - first[1]);
    const int finer = count <= 2500 ? 8 : count <= 20'000 ? 4 : 2;
    std::vector<Corners> found;
    for (const Polygon &polygon : polygons) {
        Corners corners({static_cast<py::ssize_t>(polygon.size()), py::ssize_t{2}});
        std::int32_t *corner = corners.mutable_data();
        for (const auto &at : polygon) {
            for (const int axis : {0, 1}) {
                // The centres of pixels are whole numbers, of the finer ones too.
                const double place = (at[axis] - first[axis] + 0.5) * finer - 0.5;
                *corner++ = static_cast<std::int32_t>(std::nearbyint(place * (1 << kFractionBits)));
            }
        }
        found.push_back(std::move(corners));
    }
    return Drawing{slice(first[1], end[1]), slice(first[0], end[0]), finer, std::move(found)};
}

}  // namespace pixels
