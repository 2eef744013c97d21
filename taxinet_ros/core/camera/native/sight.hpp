// Ground projection of one pose: the parameters that determine every pixel's texels.
//
// With the ray of pixel (u, v) as d = A (u, v, 1) in `map` and the camera at height h above the
// point c, the ground point is c + h (dx, dy) w with w = -1/dz. As dz is linear in u and v, every
// linear ground coordinate is linear in u w and w, for any unit and origin: one pass per image.
// Footprints are exact too: with X = dx w, dX/du = w (A00 + X A20) is w^2 times a linear function
// of v alone, and dX/dv is w^2 times one of u alone.

#pragma once

#include <array>
#include <vector>

#include "common.hpp"
#include "rays.hpp"

namespace pixels {

// Two parts of a quantity, by image column and by image row.
struct Parts {
    std::vector<float> by_column, by_row;
};

// Factors on u w and on w, and a constant.
using Form = std::array<double, 3>;

class Sight {
  public:
    // Rays map a homogeneous pixel to a direction in `map`, (3, 3); camera position (3,) [m].
    Sight(const Doubles &rays, const Doubles &camera, int height, int width);

    // Two summands of -dz.
    Parts fall() const;

    // Factors on (dz)^2 that give pixels per texel along an axis of `map`: for the footprint's side
    // along v by column, and for the side along u by row. The smaller one applies.
    Parts density(int axis, double texel_m) const;

    // Ground coordinate along an axis in units of `unit_m`, plus `origin`.
    Form coordinate(int axis, double unit_m, double origin) const;

    // Ground coordinate in tiles, from the start of the tile below the camera.
    Form coordinate_in_tile(int axis, double tile_m) const;

    // First row whose middle is within `reach_m` ahead; the number of rows if none.
    int first_row_nearer_than(double reach_m) const;

    int height() const { return height_; }
    int width() const { return width_; }

  private:
    Rays rays_;
    std::array<double, 3> camera_;
    int height_, width_;
};

}  // namespace pixels
