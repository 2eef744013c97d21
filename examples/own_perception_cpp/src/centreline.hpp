// Estimates the aircraft's pose on the runway from the centreline's paint in one camera frame.
// Plain C++17, without ROS.

#ifndef OWN_PERCEPTION_CENTRELINE_HPP_
#define OWN_PERCEPTION_CENTRELINE_HPP_

#include <cstddef>
#include <cstdint>
#include <vector>

namespace own_perception
{

constexpr std::size_t kHeight = 200, kWidth = 360, kFrameBytes = kHeight * kWidth * 3;

struct Estimate
{
  double cross_track_error = 0.0;  // [m] left of the centreline positive
  double heading_error = 0.0;      // [rad] nose left positive
  bool valid = false;              // false: no line was found
};

// A point of the ground in base_link: x forward, y left [m].
struct GroundPoint
{
  double x, y;
};

// Ground point of a pixel's ray on level ground; pixel centres are whole numbers, v is below the
// horizon.
GroundPoint on_ground(double u, double v);

// Ground points, up to 60 m ahead, of pixels that are brighter than the pavement around them.
// rgb: kFrameBytes bytes, row by row.
std::vector<GroundPoint> paint(const std::uint8_t * rgb);

// The pose, at most 7.3 m and 30 degrees off, for which most paint lies on the centreline and the
// two edge lines.
Estimate centreline(const std::vector<GroundPoint> & points);

}  // namespace own_perception

#endif  // OWN_PERCEPTION_CENTRELINE_HPP_
