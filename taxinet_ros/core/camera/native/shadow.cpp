#include "shadow.hpp"

#include <algorithm>
#include <limits>

#include "pose.hpp"

namespace pixels {
namespace {

constexpr const char *kRotation = "a rotation is (3, 3)";

// Rows or columns within `edge_px` of outlines, of `count` in all.
std::array<int, 2> touched(const std::vector<Corners> &outlines, int axis, int edge_px, int count) {
    int first = std::numeric_limits<int>::max(), last = std::numeric_limits<int>::min();
    for (const Corners &outline : outlines) {
        for (py::ssize_t i = 0; i < outline.shape(0); ++i) {
            first = std::min(first, *outline.data(i, axis));
            last = std::max(last, *outline.data(i, axis));
        }
    }
    return {std::max((first >> kFractionBits) - edge_px, 0),
            std::min((last >> kFractionBits) + 1 + edge_px, count)};
}

}  // namespace

Shadow::Shadow(const Doubles &corners, std::vector<int> starts, const Point &sun,
               const Doubles &intrinsics, const std::array<int, 2> &size, double nearest_m,
               double farthest_px, int edge_px)
    : corners_(points_of(corners, starts)),
      starts_(std::move(starts)),
      flatten_({{{1.0, 0.0, -sun[0] / sun[2]}, {0.0, 1.0, -sun[1] / sun[2]}, {0.0, 0.0, 0.0}}}),
      pinhole_(intrinsics, size, nearest_m, farthest_px),
      size_(size),
      edge_px_(edge_px) {}

std::optional<Shadow::Seen> Shadow::outlines(const Doubles &body, const Point &place,
                                             const Doubles &to_optical,
                                             const Point &camera) const {
    const Matrix optical = matrix_of(to_optical, kRotation), turn = product(optical, flatten_);
    const Point there = product(turn, place), here = product(optical, camera);
    const Point shift{there[0] - here[0], there[1] - here[1], there[2] - here[2]};
    const std::vector<Corners> found = pinhole_.outlines(
        placed(product(turn, matrix_of(body, kRotation)), shift, corners_), starts_);
    if (found.empty()) {
        return std::nullopt;
    }
    const auto [left, right] = touched(found, 0, edge_px_, size_[1]);
    const auto [top, bottom] = touched(found, 1, edge_px_, size_[0]);
    if (left >= right || top >= bottom) {
        return std::nullopt;  // they only seemed to be in view
    }
    return Seen{slice(top, bottom), slice(left, right), found};
}

}  // namespace pixels
