// Textures, and positions of a row's pixels in them.

#pragma once

#include <utility>
#include <vector>

#include "common.hpp"

namespace pixels {

// An image of three channels for lookups.
struct Texture {
    Bytes owner;
    const std::uint8_t *texels;
    int rows, columns;

    explicit Texture(Bytes array, const char *what = "a texture")
        : owner(std::move(array)), texels(nullptr), rows(0), columns(0) {
        require(owner.ndim() == 3 && owner.shape(2) == kChannels && owner.shape(0) > 1 &&
                    owner.shape(1) > 1,
                what, " is (rows, columns, 3), two of each at least");
        texels = owner.data();
        rows = static_cast<int>(owner.shape(0));
        columns = static_cast<int>(owner.shape(1));
    }

    // Bytes from one row to the next.
    std::ptrdiff_t stride() const { return static_cast<std::ptrdiff_t>(columns) * kChannels; }
};

// Positions of the pixels of one image row between four texels of a texture: offset of the upper
// left texel; weights of left, right, above and below, a byte each. Each pair adds up to 32.
struct Places {
    std::vector<std::int32_t> offset, weights;
    std::int32_t furthest = 0;  // no offset is greater

    explicit Places(int width) : offset(width), weights(width) {}
};

// Weights of four texels, from those of the right and the lower ones.
INLINE std::int32_t weights_of(std::int32_t right, std::int32_t below) {
    constexpr std::int32_t kBoth = kSteps << 16 | kSteps;
    const std::int32_t seconds = below << 16 | right;
    return (seconds << 8) - seconds + kBoth;
}

// Maximum of offsets. A loop of its own: within that of the ground's places it keeps compilers from
// vectors.
INLINE std::int32_t furthest_of(const std::int32_t *offsets, int count) {
    std::int32_t most = 0;
    for (int i = 0; i < count; ++i) {
        most = greater(most, offsets[i]);
    }
    return most;
}

// Bilinear interpolation of one channel; weights of the right and lower texels are in 32 steps.
INLINE std::int32_t blended(const std::uint8_t *upper, const std::uint8_t *lower, int left,
                            int right, int of_right, int of_lower) {
    const int high = upper[left] * (kSteps - of_right) + upper[right] * of_right;
    const int low = lower[left] * (kSteps - of_right) + lower[right] * of_right;
    return (high * (kSteps - of_lower) + low * of_lower + kWhole / 2) / kWhole;
}

}  // namespace pixels
