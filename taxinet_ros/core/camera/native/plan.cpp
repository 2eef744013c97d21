#include "plan.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace pixels {
namespace {

struct Edge {
    std::array<double, 2> start, along;

    // Positive where a point is on the left.
    double side(double x, double y) const {
        return along[0] * (y - start[1]) - along[1] * (x - start[0]);
    }

    // Whether the ends of another edge are on both sides.
    bool parts(const Edge &other) const {
        const auto &[x, y] = other.start;
        return side(x, y) * side(x + other.along[0], y + other.along[1]) < 0;
    }

    // Square of the distance of a point.
    double away2(double x, double y) const {
        const double length2 = along[0] * along[0] + along[1] * along[1];
        x -= start[0];
        y -= start[1];
        const double part = std::clamp((x * along[0] + y * along[1]) / length2, 0.0, 1.0);
        const double dx = x - part * along[0], dy = y - part * along[1];
        return dx * dx + dy * dy;
    }
};

using Edges = std::vector<Edge>;

std::vector<Edges> edges_of(const Doubles &corners, const std::vector<int> &starts) {
    require(corners.ndim() == 2 && corners.shape(1) == 2, "corners in plan are (N, 2)");
    const int count = static_cast<int>(corners.shape(0));
    std::vector<Edges> found;
    for (std::size_t i = 0; i < starts.size(); ++i) {
        const int first = starts[i], end = i + 1 < starts.size() ? starts[i + 1] : count;
        require(0 <= first && first < end && end <= count,
                "polygons start one after the other, within the corners");
        Edges &edges = found.emplace_back();
        for (int k = first; k < end; ++k) {
            const int next = k + 1 < end ? k + 1 : first;
            const double x = corners.at(k, 0), y = corners.at(k, 1);
            edges.push_back({{x, y}, {corners.at(next, 0) - x, corners.at(next, 1) - y}});
        }
    }
    return found;
}

// Square of the least distance of the corners of one to the edges of another, 0 within it.
double away2(const Edges &polygon, const Edges &corners) {
    double least2 = std::numeric_limits<double>::infinity();
    for (const Edge &corner : corners) {
        const auto [x, y] = corner.start;
        bool within = true;
        for (const Edge &edge : polygon) {
            within = within && edge.side(x, y) >= 0;
            const bool crosses = edge.parts(corner) && corner.parts(edge);
            least2 = std::min(least2, crosses ? 0.0 : edge.away2(x, y));
        }
        least2 = within ? 0.0 : least2;
    }
    return least2;
}

}  // namespace

double gap(const Doubles &corners, const std::vector<int> &starts, const Doubles &other_corners,
           const std::vector<int> &other_starts) {
    double least2 = std::numeric_limits<double>::infinity();
    const std::vector<Edges> others = edges_of(other_corners, other_starts);
    for (const Edges &one : edges_of(corners, starts)) {
        for (const Edges &other : others) {
            least2 = std::min({least2, away2(one, other), away2(other, one)});
        }
    }
    return std::sqrt(least2);
}

}  // namespace pixels
