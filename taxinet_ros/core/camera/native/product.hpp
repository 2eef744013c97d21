// The product of what two textures show: the ground and its grain.

#pragma once

#include <array>

#include "common.hpp"
#include "texture.hpp"

namespace pixels {

using Colour = std::array<std::int32_t, kChannels>;

// What is looked up for one row: a texture, and where in it. Without a texture it is one colour.
struct Layer {
    const Texture *texture;
    const Places *places;
    Colour plain;
};

// Bytes that may be written to beyond a row.
constexpr int kBytesBeyond = 4;

// Fills the columns from `first` on: the product of both, times a scale, as codes.
void multiply_row(const Layer &ground, const Layer &grain, float scale, int first, int width,
                  std::uint8_t *row);

}  // namespace pixels
