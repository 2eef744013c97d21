#include "air.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace pixels {
namespace {

// Smaller shares of the veil are invisible.
constexpr double kVisibleShare = 1.0 / 400;

// Image row in which directions are compared with the sun's.
constexpr double kRowOfYaw = 60.0;

// The glare vanishes beyond this number of half widths; the other is more than rounding makes of it.
constexpr double kGlareReach = 3.0, kMargin = 1e-9;

const double kSineOf15Deg = std::sin(std::numbers::pi / 12);

// Sines of the depression of each row's central ray, > 0.
std::vector<double> sines(const Rays &rays, int height, int width) {
    std::vector<double> found(height);
    for (int v = 0; v < height; ++v) {
        const auto [x, y, z] = ray_of(rays, (width - 1) / 2.0, v);
        found[v] = std::clamp(-z / std::sqrt(x * x + y * y + z * z), 1e-4, 1.0);
    }
    return found;
}

// Fresnel reflectance of water (Schlick's approximation).
double reflected(double sine) {
    const double rest = 1 - sine, square = rest * rest;
    return 0.02 + 0.98 * square * square * rest;
}

}  // namespace

std::pair<Doubles, Doubles> Air::veil(const Doubles &directions, double height_m, int height,
                                      int width) const {
    const std::vector<double> sine = sines(rays_of(directions), height, width);
    std::vector<double> haze(height), mirror(height), share(height);
    int rows = 0;
    for (int v = 0; v < height; ++v) {
        haze[v] = 1 - std::exp(-height_m / sine[v] / visibility_m);
        mirror[v] = film * reflected(sine[v]) + spray;
        share[v] = 1 - (1 - haze[v]) * (1 - mirror[v]);
        rows = share[v] > kVisibleShare ? v + 1 : rows;
    }
    Doubles kept(rows), added({rows, kChannels});
    for (int v = 0; v < rows; ++v) {
        *kept.mutable_data(v) = 255 * (1 - share[v]);
        const double rise = std::sqrt(std::min(sine[v] / kSineOf15Deg, 1.0));
        for (int c = 0; c < kChannels; ++c) {
            const double mirrored = 0.92 * (sky_low[c] + (sky_high[c] - sky_low[c]) * rise);
            *added.mutable_data(v, c) =
                haze[v] * sky_low[c] + (1 - haze[v]) * mirror[v] * mirrored;
        }
    }
    return {kept, added};
}

std::optional<std::pair<Floats, Floats>> Air::shine(const Doubles &directions, int height,
                                                    int width) const {
    const Rays rays = rays_of(directions);
    const auto turn = [&](int u) {
        const auto [x, y, z] = ray_of(rays, u, kRowOfYaw);
        return std::remainder(std::atan2(y, x) - sun_yaw_rad, 2 * std::numbers::pi);
    };
    // Unless the sun is between them, the first or the last column is nearest to it.
    const double first = turn(0), last = turn(width - 1);
    const bool between =
        first * last <= 0 && std::abs(first) + std::abs(last) < std::numbers::pi;
    const double beside = std::min(std::abs(first), std::abs(last)) / glare_width_rad;
    if (!between && beside > kGlareReach + kMargin) {
        return std::nullopt;
    }
    Floats by_row(height), by_column(width);
    double nearest = kGlareReach;
    for (int u = 0; u < width; ++u) {
        const double away = std::abs(turn(u)) / glare_width_rad;
        nearest = std::min(nearest, away);
        *by_column.mutable_data(u) = static_cast<float>(std::exp(-0.5 * away * away));
    }
    if (nearest >= kGlareReach) {
        return std::nullopt;
    }
    const std::vector<double> sine = sines(rays, height, width);
    for (int v = 0; v < height; ++v) {
        // Strongest at grazing angles.
        *by_row.mutable_data(v) = static_cast<float>(glare * (std::exp(-sine[v] / 0.10) + 0.12));
    }
    return std::pair{by_row, by_column};
}

}  // namespace pixels
