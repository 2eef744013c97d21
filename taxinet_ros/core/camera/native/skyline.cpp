#include "skyline.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <vector>

#include "product.hpp"

namespace pixels {
namespace {

// Codes with two columns more, which repeat the first two: positions between the last column and the
// first need no other code, and vector code may read beyond a texel.
Bytes repeated(const Bytes &codes) {
    const Texture once(codes, "a panorama");
    Bytes twice({once.rows, once.columns + 2, kChannels});
    for (int row = 0; row < once.rows; ++row) {
        const std::uint8_t *from = once.texels + row * once.stride();
        std::uint8_t *to = twice.mutable_data(row);
        std::memcpy(to, from, once.stride());
        std::memcpy(to + once.stride(), from, 2 * kChannels);
    }
    return twice;
}

// Number of image rows from the top in which some ray falls by less than a tangent.
int rows_above(const Rays &rays, double end_tan, const Rows &picture) {
    const auto &[f0, f1, f2] = rays[2];
    const double left = (-end_tan - f2) / f1;
    const double right = (-end_tan - (f0 * (picture.width - 1) + f2)) / f1;
    const double last = std::floor(std::max(left, right));
    return static_cast<int>(std::clamp(last + 1, 0.0, static_cast<double>(picture.count)));
}

// Numbers of a row's pixels, interpolated between those to the left and to the right of each.
FOR_EACH_PROCESSOR void interpolate(const float *__restrict sparse,
                                    const std::int32_t *__restrict left,
                                    const float *__restrict share, int width,
                                    float *__restrict out) {
    INDEPENDENT
    for (int u = 0; u < width; ++u) {
        const float first = sparse[left[u]];
        out[u] = __builtin_fmaf(sparse[left[u] + 1] - first, share[u], first);
    }
}

// Compatibility with bags rendered by an earlier version, which interpolated by cv::resize: it uses
// different arithmetic for a single row.
void interpolate_alone(const float *sparse, const std::int32_t *left, const float *share, int width,
                       float *out) {
    for (int u = 0; u < width; ++u) {
        out[u] = sparse[left[u]] * (1 - share[u]) + sparse[left[u] + 1] * share[u];
    }
}

// Positions at columns and rows of a panorama with two columns more, at most one turn outside it.
FOR_EACH_PROCESSOR void find_places(const float *__restrict across, const float *__restrict up,
                                    int width, int columns, int rows, Places &places) {
    std::int32_t *__restrict offset = places.offset.data();
    std::int32_t *__restrict weights = places.weights.data();
    INDEPENDENT
    for (int u = 0; u < width; ++u) {
        const std::int32_t x = rounded(across[u] * kSteps), y = rounded(up[u] * kSteps);
        std::int32_t left = x >> kStepBits;
        left += left < 0 ? columns : 0;
        left -= left < columns ? 0 : columns;
        const std::int32_t top = lesser(y >> kStepBits, rows - 2);
        offset[u] = (top * (columns + 2) + left) * kChannels;
        weights[u] = weights_of(x & (kSteps - 1), y - top * kSteps);
    }
    places.furthest = furthest_of(offset, width);
}

}  // namespace

Panorama::Panorama(const Bytes &codes, double lowest_rad, double step_rad, double end_tan,
                   int spacing_px)
    : codes_(repeated(codes)),
      columns_(codes_.columns - 2),
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
    const int width = target.width;
    require(width % spacing_ == 0, "the distance of directions divides a picture's width");
    const int rows = rows_above(rays, end_tan_, target);
    const bool alone = rows == 1;
    // One extra column on both sides, so that every image column lies between two.
    const int sparse = width / spacing_ + 2;
    std::vector<float> across(sparse), up(sparse), share(width);
    std::vector<std::int32_t> left(width);
    for (int u = 0; u < width; ++u) {
        const int from_first = u - first_column_;
        left[u] = from_first / spacing_;
        share[u] = static_cast<float>(from_first % spacing_ / static_cast<double>(spacing_));
        if (alone) {
            const double place = (u + spacing_ + 0.5) * (1.0 / spacing_) - 0.5;
            share[u] = static_cast<float>(place) - static_cast<float>(left[u]);
        }
    }
    const Ray middle = ray_of(rays, first_column_ + sparse / 2 * spacing_, 0);
    const auto lowest = static_cast<float>((-std::atan(end_tan_) - lowest_rad_) / step_rad_);
    Places places(width);
    const Layer sky{&codes_, &places, {}}, nothing{nullptr, nullptr, {1, 1, 1}};
    std::vector<float> column(width), height(width);
    std::vector<std::uint8_t> row(target.bytes() + kBytesBeyond);
    const auto between = alone ? interpolate_alone : interpolate;
    for (int v = 0; v < rows; ++v) {
        find_directions(rays, middle, v, across, up);
        between(across.data(), left.data(), share.data(), width, column.data());
        between(up.data(), left.data(), share.data(), width, height.data());
        find_places(column.data(), height.data(), width, columns_, codes_.rows, places);
        multiply_row(sky, nothing, 1, 0, width, row.data());
        std::uint8_t *colours = target.at(v);
        // Those between are as high, but for rounding.
        if (*std::min_element(up.begin(), up.end()) > lowest + 1) {
            std::memcpy(colours, row.data(), target.bytes());
            continue;
        }
        for (int u = 0; u < width; ++u) {
            if (height[u] > lowest) {
                std::memcpy(colours + kChannels * u, &row[kChannels * u], kChannels);
            }
        }
    }
}

void Panorama::find_directions(const Rays &rays, const Ray &middle, int v,
                               std::vector<float> &across, std::vector<float> &up) const {
    // Relative to the centre of the view, yaw has no discontinuity inside the image.
    const double cos = middle[0], sin = middle[1];
    const double north = std::atan2(sin, cos) + std::numbers::pi;
    const double per_radian = columns_ / (2 * std::numbers::pi);
    for (std::size_t i = 0; i < across.size(); ++i) {
        const auto [x, y, z] = ray_of(rays, first_column_ + static_cast<int>(i) * spacing_, v);
        const double aside = std::atan2(cos * y - sin * x, cos * x + sin * y);
        const double row = (std::atan2(z, std::hypot(x, y)) - lowest_rad_) / step_rad_;
        across[i] = static_cast<float>((north + aside) * per_radian);
        up[i] = static_cast<float>(std::clamp(row, 0.0, codes_.rows - 1.0));
    }
}

}  // namespace pixels
