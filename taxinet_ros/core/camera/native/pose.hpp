// Where a camera on an aircraft is, and where it looks; used by camera.py.

#pragma once

#include <tuple>

#include "outline.hpp"

namespace pixels {

// Products with the roundings of OpenBLAS for processors that fuse, so that pictures of versions
// that used NumPy here keep their bytes.
Matrix product(const Matrix &a, const Matrix &b);
Point product(const Matrix &a, const Point &b);

// Rotation from the body frame to `map` and from there to the optical frame, (3, 3), and the
// camera's place in `map`. `numbers` are the aircraft's place and its roll, pitch and yaw.
std::tuple<Doubles, Doubles, Doubles> pose(const std::array<double, 6> &numbers,
                                           const Doubles &body_to_optical, const Point &offset);

}  // namespace pixels
