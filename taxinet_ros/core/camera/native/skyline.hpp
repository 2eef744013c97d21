// What stands at the horizon, looked up in a panorama: what atmosphere.py asks for.

#pragma once

#include <vector>

#include "common.hpp"
#include "picture.hpp"
#include "rays.hpp"
#include "texture.hpp"

namespace pixels {

class Panorama {
  public:
    // Codes (rows, columns, 3); columns are counted from yaw -pi and go round, rows upwards from an
    // elevation [rad]. It begins where a ray falls by less than that tangent. Directions are
    // computed for columns of the picture that are `spacing_px` apart, and interpolated between.
    Panorama(Bytes codes, double lowest_rad, double step_rad, double end_tan, int spacing_px);

    // Replaces what lies above the end of the ground. Directions (3, 3): see rays_of.
    void lay_over(Picture picture, const Doubles &directions) const;

  private:
    // In columns and rows of the panorama; columns may go on beyond its end.
    struct Place {
        float across, up;
    };

    // Which direction a column of the picture is next to on its right, and what share of the way to
    // the following one.
    struct Between {
        int left;
        float share;
    };

    // OpenCV's cv::resize, which interpolated at first, has an arithmetic of its own for a row that
    // is alone. Bags from then shall give the same bytes when they are rendered.
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
