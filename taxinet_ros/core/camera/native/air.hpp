// What air, water and a low sun add to rows and columns of a picture: what atmosphere.py asks for.

#pragma once

#include <array>
#include <optional>
#include <utility>

#include "common.hpp"
#include "rays.hpp"

namespace pixels {

// The air of one scenario.
struct Air {
    // Distance at which haze leaves 1/e of a contrast.
    double visibility_m;
    // Share of the ground that is film of water, and of the picture that is spray.
    double film, spray;
    // Display colours of the sky at the horizon and 15 degrees up.
    std::array<double, kChannels> sky_low, sky_high;
    // Brightness of the glare, and the sun's direction and half the glare's width [rad].
    double glare, sun_yaw_rad, glare_width_rad;

    // What haze and the sky's mirror image make of the upper rows of the ground: the share of its
    // colour that each row keeps, in 255ths (n,), and what is added (n, 3). The rows below keep
    // all, but for what is not seen.
    std::pair<Doubles, Doubles> veil(const Doubles &directions, double height_m, int height,
                                     int width) const;

    // A broad shine on the ground under a low sun: strength by row and by column. None where the
    // sun is far aside.
    std::optional<std::pair<Floats, Floats>> shine(const Doubles &directions, int height,
                                                   int width) const;
};

}  // namespace pixels
