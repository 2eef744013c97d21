// Where the panorama of the sky is looked up: what atmosphere.py asks for.

#pragma once

#include <array>
#include <utility>

#include "common.hpp"

namespace pixels {

// Column and row of a panorama, (rows, n) each, that the rays of some columns (n,) of the upper
// rows of a picture meet. The panorama's measures are its columns per radian, counted from yaw -pi,
// the elevation of its row 0 and the step between its rows [rad], and the number of rows.
std::pair<Floats, Floats> on_panorama(const Doubles &rays, const Doubles &columns, int rows,
                                      const std::array<double, 4> &measures);

}  // namespace pixels
