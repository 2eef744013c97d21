// Light, shade and haze on an image, in place. Shares are in 255ths, and every product is rounded.

#pragma once

#include <array>

#include "common.hpp"
#include "picture.hpp"

namespace pixels {

// Multiplies each row by a share per channel, (rows, 3).
void tint_rows(Picture picture, const Doubles &shares);

// Darkens each pixel by its mask code; 255 is the full depth (0 to 1) per channel.
void tint_masked(Picture picture, const Picture &mask, const std::array<float, 3> &depth);

// Averages a canvas that is some times finer than a mask (rows, columns), or than a picture: then it
// has four codes a pixel, the last of which is 1 where something is drawn, and all are 0 elsewhere.
void average(const Bytes &canvas, Picture picture);

// Paints each pixel by its mask code; 255 is the full opacity (0 to 1).
void blend_masked(Picture picture, const Picture &mask, const std::array<float, 3> &paint,
                  double opacity);

// Applies the curve to every code; then multiplies the upper rows by a share (n,) and adds colours
// (n, 3).
void develop(Picture ground, const Bytes &curve, const Doubles &kept, const Doubles &added,
             Picture picture);

// Multiplies each channel of each pixel by a share and adds a code; both have the image's size.
void lay_over(Picture picture, const Bytes &kept, const Bytes &added);

// Adds the product of strengths by row, by column and by channel.
void add_shine(Picture picture, const Floats &by_row, const Floats &by_column,
               const std::array<float, 3> &tint);

}  // namespace pixels
