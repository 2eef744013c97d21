// Projection of the convex parts of a body; used by airframe.py.

#pragma once

#include <array>
#include <vector>

#include "common.hpp"

namespace pixels {

using Corners = py::array_t<std::int32_t>;

// For each convex part that may touch the image, the corners of its outline, or points inside it,
// (n, 2), in sixteenths of a pixel.
//
// Corners (N, 3) are in the camera's optical frame; starts are the first corners of the parts, in
// order. Intrinsics is the camera matrix (3, 3), size the image height and width [px]. Parts are
// clipped at depth `nearest_m`, and coordinates clamped to `farthest_px`.
std::vector<Corners> outlines(const Doubles &corners, const std::vector<int> &starts,
                              const Doubles &intrinsics, const std::array<int, 2> &size,
                              double nearest_m, double farthest_px);

}  // namespace pixels
