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
    Panorama(Bytes codes, double lowest_rad, double step_rad, double end_tan, int spacing_px);

    // Draws the panorama above the end of the ground. Directions (3, 3): see rays_of.
    void lay_over(Picture picture, const Doubles &directions) const;

  private:
    // Position in columns and rows of the panorama; columns may exceed its end.
    struct Place {
        float across, up;
    };

    // Index of the computed direction to the left of an image column, and the fraction of the way
    // to the next one.
    struct Between {
        int left;
        float share;
    };

    // Compatibility with bags rendered by an earlier version, which interpolated by cv::resize: it
    // uses different arithmetic for a single row.
    std::vector<Between> columns_between(int width, bool alone) const;
    static Place between(const Place &a, const Place &b, float share);
    static Place between_alone(const Place &a, const Place &b, float share);
    void find_places(const Rays &rays, const Ray &middle, int v, std::vector<Place> &places) const;
    void look_up(const Place &place, std::uint8_t *colour) const;

    Texture codes_;
    double lowest_rad_, step_rad_, end_tan_;
    int spacing_, first_column_;
};

}  // namespace pixels
