// How one pose sees the ground: the few numbers from which every pixel's texels follow.
//
// With the ray of pixel (u, v) as d = A (u, v, 1) in `map` and the camera at height h over the
// place c, the ground point is c + h (dx, dy) w with w = -1/dz. As dz is linear in u and v, so is
// every linear ground coordinate in u w and w, whatever its unit and origin: one pass over the
// picture. The footprints are exact too: with X = dx w, dX/du = w (A00 + X A20) is w^2 times a
// linear function of v alone, and dX/dv is w^2 times one of u alone.

#pragma once

#include <array>
#include <vector>

#include "common.hpp"
#include "rays.hpp"

namespace pixels {

// Two parts of a quantity, by column and by row of the picture.
struct Parts {
    std::vector<float> by_column, by_row;
};

// Factors on u w and on w, and a constant.
using Form = std::array<double, 3>;

class Sight {
  public:
    // From homogenous pixel to a direction in `map`, (3, 3), and the camera's place there (3,) [m].
    Sight(const Doubles &rays, const Doubles &camera, int height, int width);

    // The two parts whose sum is -dz.
    Parts fall() const;

    // Factors on (dz)^2 that give pixels per texel along an axis of `map`: of the footprint's side
    // along v by column, and of the one along u by row. The smaller one counts.
    Parts density(int axis, double texel_m) const;

    // Ground coordinate along an axis in units of `unit_m`, plus `origin`.
    Form coordinate(int axis, double unit_m, double origin) const;

    // The same, from the beginning of the tile of that size that the camera is over.
    Form coordinate_in_tile(int axis, double tile_m) const;

    // First row whose middle lies within `reach_m` ahead; the number of rows if none does.
    int first_row_nearer_than(double reach_m) const;

    int height() const { return height_; }
    int width() const { return width_; }

  private:
    Rays rays_;
    std::array<double, 3> camera_;
    int height_, width_;
};

}  // namespace pixels
