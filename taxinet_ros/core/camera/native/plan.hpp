// Distances in plan; used by clearance.py.

#pragma once

#include <vector>

#include "common.hpp"

namespace pixels {

// Least distance of a convex polygon to others [m]; 0 where it overlaps one.
//
// Corners are (N, 3), of which the height does not count, counter-clockwise; starts are the first
// ones of the others, in order.
double gap(const Doubles &corners, const std::vector<int> &starts, const Doubles &polygon);

}  // namespace pixels
