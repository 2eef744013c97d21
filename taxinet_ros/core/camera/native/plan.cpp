#include "plan.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "outline.hpp"

namespace pixels {
namespace {

struct Edge {
    double x, y, along_x, along_y;

    // Positive where a point is on the left.
    double side(double u, double v) const { return along_x * (v - y) - along_y * (u - x); }

    // Whether the ends of another edge are on both sides.
    bool parts(const Edge &other) const {
        return side(other.x, other.y) * side(other.x + other.along_x, other.y + other.along_y) < 0;
    }

    // Square of the distance of a point.
    double away2(double u, double v) const {
        const double length2 = along_x * along_x + along_y * along_y;
        const double share =
            std::clamp(((u - x) * along_x + (v - y) * along_y) / length2, 0.0, 1.0);
        const double du = u - x - share * along_x, dv = v - y - share * along_y;
        return du * du + dv * dv;
    }
};

using Edges = std::vector<Edge>;

Edges edges_of(const std::vector<Point> &points, std::size_t first, std::size_t end) {
    Edges edges;
    for (std::size_t i = first; i < end; ++i) {
        const auto &[x, y, z] = points[i];
        const Point &next = points[i + 1 < end ? i + 1 : first];
        edges.push_back({x, y, next[0] - x, next[1] - y});
    }
    return edges;
}

// Square of the least distance of corners to the edges of a polygon, 0 within it.
double away2(const Edges &polygon, const Edges &corners) {
    double least2 = std::numeric_limits<double>::infinity();
    for (const Edge &corner : corners) {
        bool within = true;
        for (const Edge &edge : polygon) {
            within = within && edge.side(corner.x, corner.y) >= 0;
            const bool cross = edge.parts(corner) && corner.parts(edge);
            least2 = std::min(least2, cross ? 0.0 : edge.away2(corner.x, corner.y));
        }
        least2 = within ? 0.0 : least2;
    }
    return least2;
}

}  // namespace

double gap(const Doubles &corners, const std::vector<int> &starts, const Doubles &polygon) {
    const std::vector<Point> points = points_of(corners, starts), other = points_of(polygon, {});
    const Edges one = edges_of(other, 0, other.size());
    double least2 = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < starts.size(); ++i) {
        const std::size_t end = i + 1 < starts.size() ? starts[i + 1] : points.size();
        const Edges own = edges_of(points, starts[i], end);
        least2 = std::min({least2, away2(own, one), away2(one, own)});
    }
    return std::sqrt(least2);
}

}  // namespace pixels
