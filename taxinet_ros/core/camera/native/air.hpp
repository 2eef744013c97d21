// Effects of haze, water and a low sun on rows and columns of an image; used by atmosphere.py.

#pragma once

#include <array>
#include <optional>
#include <utility>

#include "common.hpp"
#include "rays.hpp"

namespace pixels {

// Atmosphere of one scenario.
struct Air {
    // Distance at which haze reduces contrast to 1/e.
    double visibility_m;
    // Share of the ground covered by water, and opacity of the uniform spray.
    double film, spray;
    // Display colours of the sky at the horizon and 15 degrees up.
    std::array<double, kChannels> sky_low, sky_high;
    // Brightness of the glare, direction of the sun, and half the glare's width [rad].
    double glare, sun_yaw_rad, glare_width_rad;

    // Effect of haze and of the sky's reflection on the upper rows of the ground: remaining share
    // of the colour in 255ths (n,), and added colour (n, 3). The effect on the rows below is
    // invisible.
    std::pair<Doubles, Doubles> veil(const Doubles &directions, double height_m, int height,
                                     int width) const;

    // Broad glare on the ground under a low sun: strength by row and by column. None if the sun is
    // far to the side.
    std::optional<std::pair<Floats, Floats>> shine(const Doubles &directions, int height,
                                                   int width) const;
};

}  // namespace pixels
