#include "skyline.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace pixels {
namespace {

// Wraps a column that is at most one turn outside the panorama.
INLINE int wrapped(int column, int count) {
    column += column < 0 ? count : 0;
    return column < count ? column : column - count;
}

// Number of image rows from the top in which some ray falls by less than a tangent.
int rows_above(const Rays &rays, double end_tan, const Rows &picture) {
    const auto &[f0, f1, f2] = rays[2];
    const double left = (-end_tan - f2) / f1;
    const double right = (-end_tan - (f0 * (picture.width - 1) + f2)) / f1;
    const double last = std::floor(std::max(left, right));
    return static_cast<int>(std::clamp(last + 1, 0.0, static_cast<double>(picture.count)));
}

}  // namespace

Panorama::Panorama(Bytes codes, double lowest_rad, double step_rad, double end_tan, int spacing_px)
    : codes_(std::move(codes), "a panorama"),
      lowest_rad_(lowest_rad),
      step_rad_(step_rad),
      end_tan_(end_tan),
      spacing_(spacing_px),
      first_column_(-(spacing_px + 1) / 2) {
    require(spacing_ > 0 && spacing_ % 2 == 1, "directions are an odd number of columns apart");
}

void Panorama::lay_over(Picture picture, const Doubles &directions) const {
    const Rows target(picture);
    const Rays rays = rays_of(directions);
    require(target.width % spacing_ == 0, "the distance of directions divides a picture's width");
    // One extra column on both sides, so that every image column lies between two.
    std::vector<Place> places(target.width / spacing_ + 2);
    const int middle_column = first_column_ + static_cast<int>(places.size()) / 2 * spacing_;
    const Ray middle = ray_of(rays, middle_column, 0);
    const auto lowest = static_cast<float>((-std::atan(end_tan_) - lowest_rad_) / step_rad_);
    const int rows = rows_above(rays, end_tan_, target);
    const bool alone = rows == 1;
    const std::vector<Between> columns = columns_between(target.width, alone);
    for (int v = 0; v < rows; ++v) {
        find_places(rays, middle, v, places);
        std::uint8_t *colour = target.at(v);
        for (const Between &column : columns) {
            const Place &left = places[column.left], &right = places[column.left + 1];
            const Place place = alone ? between_alone(left, right, column.share)
                                      : between(left, right, column.share);
            if (place.up > lowest) {
                look_up(place, colour);
            }
            colour += kChannels;
        }
    }
}

std::vector<Panorama::Between> Panorama::columns_between(int width, bool alone) const {
    std::vector<Between> columns(width);
    for (int u = 0; u < width; ++u) {
        const int from_first = u - first_column_;
        const double share = from_first % spacing_ / static_cast<double>(spacing_);
        columns[u] = {from_first / spacing_, static_cast<float>(share)};
        if (alone) {
            const double place = (u + spacing_ + 0.5) * (1.0 / spacing_) - 0.5;
            columns[u].share = static_cast<float>(place) - static_cast<float>(columns[u].left);
        }
    }
    return columns;
}

INLINE Panorama::Place Panorama::between(const Place &a, const Place &b, float share) {
    return {__builtin_fmaf(b.across - a.across, share, a.across),
            __builtin_fmaf(b.up - a.up, share, a.up)};
}

INLINE Panorama::Place Panorama::between_alone(const Place &a, const Place &b, float share) {
    return {a.across * (1 - share) + b.across * share, a.up * (1 - share) + b.up * share};
}

void Panorama::find_places(const Rays &rays, const Ray &middle, int v,
                           std::vector<Place> &places) const {
    // Relative to the centre of the view, yaw has no discontinuity inside the image.
    const double cos = middle[0], sin = middle[1];
    const double north = std::atan2(sin, cos) + std::numbers::pi;
    const double per_radian = codes_.columns / (2 * std::numbers::pi);
    for (std::size_t i = 0; i < places.size(); ++i) {
        const auto [x, y, z] = ray_of(rays, first_column_ + static_cast<int>(i) * spacing_, v);
        const double aside = std::atan2(cos * y - sin * x, cos * x + sin * y);
        const double row = (std::atan2(z, std::hypot(x, y)) - lowest_rad_) / step_rad_;
        places[i] = {static_cast<float>((north + aside) * per_radian),
                     static_cast<float>(std::clamp(row, 0.0, codes_.rows - 1.0))};
    }
}

INLINE void Panorama::look_up(const Place &place, std::uint8_t *colour) const {
    const std::int32_t x = rounded(place.across * kSteps), y = rounded(place.up * kSteps);
    const int columns = codes_.columns;
    const int left = wrapped(x >> kStepBits, columns), right = wrapped(left + 1, columns);
    const int row = y >> kStepBits, next = lesser(row + 1, codes_.rows - 1);
    const std::uint8_t *first = codes_.texels + row * codes_.stride();
    const std::uint8_t *second = codes_.texels + next * codes_.stride();
    for (int c = 0; c < kChannels; ++c) {
        colour[c] = static_cast<std::uint8_t>(
            blended(first, second, kChannels * left + c, kChannels * right + c,
                    x & (kSteps - 1), y & (kSteps - 1)));
    }
}

}  // namespace pixels
