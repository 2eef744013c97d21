#include "sight.hpp"

#include <algorithm>
#include <cmath>

namespace pixels {
namespace {

// Lower limit that keeps footprints from vanishing.
constexpr double kLeastSlope = 1e-9;

std::vector<float> density_along(double slope, double start, double scale, int count) {
    std::vector<float> density(count);
    for (int i = 0; i < count; ++i) {
        density[i] =
            static_cast<float>(scale / std::max(std::abs(slope * i + start), kLeastSlope));
    }
    return density;
}

}  // namespace

Sight::Sight(const Doubles &rays, const Doubles &camera, int height, int width)
    : rays_(rays_of(rays)), height_(height), width_(width) {
    require(camera.size() == 3, "a camera is at a place (3,)");
    std::copy_n(camera.data(), 3, camera_.begin());
}

Parts Sight::fall() const {
    Parts parts{std::vector<float>(width_), std::vector<float>(height_)};
    const auto &[f0, f1, f2] = rays_[2];
    for (int u = 0; u < width_; ++u) {
        parts.by_column[u] = static_cast<float>(-f0 * u);
    }
    for (int v = 0; v < height_; ++v) {
        parts.by_row[v] = static_cast<float>(-f1 * v - f2);
    }
    return parts;
}

Parts Sight::density(int axis, double texel_m) const {
    const auto &[a0, a1, a2] = rays_[axis];
    const auto &[f0, f1, f2] = rays_[2];
    const double turn = a0 * f1 - a1 * f0;
    const double scale = texel_m / camera_[2];
    return {density_along(turn, a2 * f1 - a1 * f2, scale, width_),
            density_along(turn, a0 * f2 - a2 * f0, scale, height_)};
}

Form Sight::coordinate(int axis, double unit_m, double origin) const {
    // A form in u w, v w and w; v w is eliminated by the definition of w.
    const double scale = camera_[2] / unit_m;
    const auto &[a0, a1, a2] = rays_[axis];
    const auto &[f0, f1, f2] = rays_[2];
    const double per_v = -(a1 * scale) / f1;
    const double shift = camera_[axis] / unit_m + origin;
    return {a0 * scale + per_v * f0, a2 * scale + per_v * f2, per_v + shift};
}

Form Sight::coordinate_in_tile(int axis, double tile_m) const {
    return coordinate(axis, tile_m, -std::floor(camera_[axis] / tile_m));
}

int Sight::first_row_nearer_than(double reach_m) const {
    const auto &[f0, f1, f2] = rays_[2];
    const double middle = width_ / 2.0;
    int v = 0;
    while (v < height_ && !(-(f0 * middle + f1 * v + f2) > camera_[2] / reach_m)) {
        ++v;
    }
    return v;
}

}  // namespace pixels
