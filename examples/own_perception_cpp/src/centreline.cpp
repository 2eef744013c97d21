#include "centreline.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace own_perception
{
namespace
{

// Camera parameters from camera/camera_info and the transform base_link -> camera_optical.
constexpr double kFx = 235.465, kFy = 308.219, kCx = 179.5, kCy = 57.034;
constexpr double kForward = 0.085, kLeft = -2.17, kAboveGround = 2.05;  // [m]
constexpr double kPitch = 0.18379, kYaw = -0.07243;                     // [rad] nose down, left

constexpr int kFirstRow = 12, kFirstColumn = 56;  // sky above, the aircraft's own cowling beside
constexpr int kContrast = 40;                     // codes by which paint is brighter than its row
constexpr double kFarthest = 60.0, kBin = 0.25;                      // [m]
constexpr double kEdge = 14.65;                                      // [m] to the edge lines
constexpr double kMostOffset = kEdge / 2;  // further off, an edge line may be the nearer one
constexpr double kMostHeading = 0.52, kHeadingStep = 0.01;           // [rad]
constexpr double kHalfWidth = 0.75;                                  // [m] of a line's band
constexpr int kFewest = 30;                                  // pixels of a valid line

// Cross-track offset at which an aircraft with this heading sees a ground point on the centreline.
double offset(const GroundPoint & point, double heading)
{
  return -(std::sin(heading) * point.x + std::cos(heading) * point.y);
}

}  // namespace

GroundPoint on_ground(double u, double v)
{
  const double a = (u - kCx) / kFx, b = (v - kCy) / kFy;
  const double cp = std::cos(kPitch), sp = std::sin(kPitch);
  const double cy = std::cos(kYaw), sy = std::sin(kYaw);
  const double reach = kAboveGround / (sp + b * cp);
  return {
    kForward + reach * (cy * cp + sy * a - cy * sp * b),
    kLeft + reach * (sy * cp - cy * a - sy * sp * b),
  };
}

std::vector<GroundPoint> paint(const std::uint8_t * rgb)
{
  std::vector<GroundPoint> points;
  std::array<int, kWidth - kFirstColumn> row{}, sorted{};
  for (std::size_t v = kFirstRow; v < kHeight; ++v) {
    for (std::size_t i = 0; i < row.size(); ++i) {
      const std::uint8_t * pixel = rgb + (v * kWidth + kFirstColumn + i) * 3;
      row[i] = std::min({pixel[0], pixel[1], pixel[2]});
    }
    sorted = row;
    std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
    const int bright = sorted[sorted.size() / 2] + kContrast;
    for (std::size_t i = 0; i < row.size(); ++i) {
      const GroundPoint point = on_ground(kFirstColumn + static_cast<double>(i), v);
      if (row[i] > bright && point.x < kFarthest) {
        points.push_back(point);
      }
    }
  }
  return points;
}

Estimate centreline(const std::vector<GroundPoint> & points)
{
  // Hough transform: for each heading, amount of paint by offset.
  constexpr double kReach = kMostOffset + kEdge + 2 * kBin;
  constexpr int kBins = static_cast<int>(2 * kReach / kBin);
  double heading = 0.0, at = 0.0;
  int most = 0;
  for (double h = -kMostHeading; h <= kMostHeading; h += kHeadingStep) {
    std::array<int, kBins> votes{};
    for (const auto & point : points) {
      const double bin = (offset(point, h) + kReach) / kBin;
      if (bin >= 0 && bin < kBins) {
        ++votes[static_cast<std::size_t>(bin)];
      }
    }
    for (double c = -kMostOffset; c <= kMostOffset; c += kBin) {
      int here = 0;
      for (const double line : {-kEdge, 0.0, kEdge}) {
        const int bin = static_cast<int>((c + line + kReach) / kBin);
        here += votes[bin - 1] + votes[bin] + votes[bin + 1];
      }
      if (here > most) {
        most = here;
        heading = h;
        at = c;
      }
    }
  }
  if (most < kFewest) {
    return {};
  }
  // Least-squares line y = p + q x through the points on the lines; it gives the aircraft's pose.
  double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (const auto & point : points) {
    for (const double line : {-kEdge, 0.0, kEdge}) {
      if (std::abs(offset(point, heading) - at - line) < kHalfWidth) {
        const double y = point.y + line / std::cos(heading);  // moved onto the centreline
        n += 1;
        sx += point.x;
        sy += y;
        sxx += point.x * point.x;
        sxy += point.x * y;
      }
    }
  }
  const double spread = n * sxx - sx * sx;
  if (spread <= 0) {
    return {};
  }
  const double q = (n * sxy - sx * sy) / spread, p = (sy - q * sx) / n;
  const double nose = -std::atan(q);
  return {-p * std::cos(nose), nose, true};
}

}  // namespace own_perception
