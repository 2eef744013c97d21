// Horizon of an image, looked up in a panorama; used by atmosphere.py.

#pragma once

#include <vector>

#include "common.hpp"
#include "picture.hpp"
#include "rays.hpp"
#include "texture.hpp"

namespace pixels {

class Panorama {
  public:
    // Codes (rows, columns, 3): columns cover 360 degrees from yaw -pi, rows go upwards from
    // `lowest_rad`. Rays that fall by less than the tangent `end_tan` use it. Directions are
    // computed for image columns that are `spacing_px` apart, and interpolated between them.
    Panorama(const Bytes &codes, double lowest_rad, double step_rad, double end_tan, int spacing_px);

    // Draws the panorama above the end of the ground. Directions (3, 3): see rays_of.
    void lay_over(Picture picture, const Doubles &directions) const;

  private:
    // Columns and rows of the panorama at one row's sparse directions; columns may exceed its end.
    void find_directions(const Rays &rays, const Ray &middle, int v, std::vector<float> &across,
                         std::vector<float> &up) const;

    Texture codes_;
    int columns_;
    double lowest_rad_, step_rad_, end_tan_;
    int spacing_, first_column_;
};

}  // namespace pixels
