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
// left texel; weights of left and right, a byte each, twice; weights of above and below, half a
// word each. Each pair of weights adds up to 32.
struct Places {
    std::vector<std::int32_t> offset, across, down;

    explicit Places(int width) : offset(width), across(width), down(width) {}
};

// Weights of the first and the second of two texels, packed this many bits apart.
INLINE std::int32_t weights_of(std::int32_t second, int bits) {
    return (second << bits) + kSteps - second;
}

// Bilinear interpolation of one channel; weights of the right and lower texels are in 32 steps.
INLINE std::int32_t blended(const std::uint8_t *upper, const std::uint8_t *lower, int left,
                            int right, int of_right, int of_lower) {
    const int high = upper[left] * (kSteps - of_right) + upper[right] * of_right;
    const int low = lower[left] * (kSteps - of_right) + lower[right] * of_right;
    return (high * (kSteps - of_lower) + low * of_lower + kWhole / 2) / kWhole;
}

}  // namespace pixels
