// Distances in plan; used by clearance.py.

#pragma once

#include <vector>

#include "common.hpp"

namespace pixels {

// Least distance between two sets of convex polygons [m]; 0 where they overlap.
//
// Corners are (N, 2) [m], counter-clockwise; starts are the first ones of the polygons, in order.
double gap(const Doubles &corners, const std::vector<int> &starts, const Doubles &other_corners,
           const std::vector<int> &other_starts);

}  // namespace pixels
