// Rays of image pixels.

#pragma once

#include "common.hpp"

namespace pixels {

using Ray = Matrix::value_type;

// Maps a homogeneous pixel (u, v, 1) to a direction in `map`.
using Rays = Matrix;

inline Rays rays_of(const Doubles &directions) {
    return matrix_of(directions, "rays are (3, 3)");
}

INLINE Ray ray_of(const Rays &rays, double u, double v) {
    Ray ray;
    for (int i = 0; i < 3; ++i) {
        ray[i] = rays[i][0] * u + rays[i][1] * v + rays[i][2];
    }
    return ray;
}

}  // namespace pixels
