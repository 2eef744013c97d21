// Convex parts of a body seen by a camera: what shadow.py asks for.

#pragma once

#include <array>
#include <vector>

#include "common.hpp"

namespace pixels {

using Corners = py::array_t<std::int32_t>;

// Of each convex part that may touch the picture, the corners of its outline, or points within it,
// (n, 2), in sixteenths of a pixel.
//
// Corners (N, 3) are in the camera's optical frame; starts are the first corners of the parts, in
// order. Intrinsics are the camera matrix (3, 3), size the height and width of the picture [px]. A
// part is cut off where it comes nearer than that, and a corner kept within `farthest_px`.
std::vector<Corners> outlines(const Doubles &corners, const std::vector<int> &starts,
                              const Doubles &intrinsics, const std::array<int, 2> &size,
                              double nearest_m, double farthest_px);

}  // namespace pixels
