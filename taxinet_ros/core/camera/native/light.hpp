// Light, shade and air on a picture, in place. A share is in 255ths, and every product is rounded.

#pragma once

#include <array>

#include "common.hpp"
#include "picture.hpp"

namespace pixels {

// Each row keeps a share, by channel: (rows, 3).
void tint_rows(Picture picture, const Doubles &shares);

// Each pixel loses, by channel, what its code in the mask says, 255 all of the depth (0 to 1).
void tint_masked(Picture picture, const Picture &mask, const std::array<float, 3> &depth);

// Every code becomes what the curve makes of it; then each of the upper rows keeps a share of that,
// (n,), and has something added, (n, 3).
void develop(Picture ground, const Bytes &curve, const Doubles &kept, const Doubles &added,
             Picture picture);

// Each channel of each pixel keeps a share, and has something added: the picture's size, both.
void lay_over(Picture picture, const Bytes &kept, const Bytes &added);

// Adds the product of a strength by row, one by column, and one by channel.
void add_shine(Picture picture, const Floats &by_row, const Floats &by_column,
               const std::array<float, 3> &tint);

}  // namespace pixels
