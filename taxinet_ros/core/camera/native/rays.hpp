// Rays of image pixels.

#pragma once

#include <array>

#include "common.hpp"

namespace pixels {

using Ray = std::array<double, 3>;

// Maps a homogeneous pixel (u, v, 1) to a direction in `map`.
using Rays = std::array<Ray, 3>;

inline Rays rays_of(const Doubles &directions) {
    require(directions.ndim() == 2 && directions.shape(0) == 3 && directions.shape(1) == 3,
            "rays are (3, 3)");
    Rays rays;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            rays[i][j] = directions.at(i, j);
        }
    }
    return rays;
}

INLINE Ray ray_of(const Rays &rays, double u, double v) {
    Ray ray;
    for (int i = 0; i < 3; ++i) {
        ray[i] = rays[i][0] * u + rays[i][1] * v + rays[i][2];
    }
    return ray;
}

}  // namespace pixels
