// Product of two textures: the ground and its grain.

#pragma once

#include <array>

#include "common.hpp"
#include "texture.hpp"

namespace pixels {

using Colour = std::array<std::int32_t, kChannels>;

// A texture and the positions looked up for one row. Without a texture: a plain colour.
struct Layer {
    const Texture *texture;
    const Places *places;
    Colour plain;
};

// Number of bytes that may be written beyond a row.
constexpr int kBytesBeyond = 4;

// Fills the columns from `first` on with the product of both, times a scale, as codes.
void multiply_row(const Layer &ground, const Layer &grain, float scale, int first, int width,
                  std::uint8_t *row);

}  // namespace pixels
