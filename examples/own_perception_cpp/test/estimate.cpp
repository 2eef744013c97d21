// Reads camera frames, 200 x 360 x 3 bytes each, and prints "valid cte_m he_rad" for each.

#include <cstdio>
#include <vector>

#include "../src/centreline.hpp"

int main()
{
  std::vector<std::uint8_t> frame(own_perception::kFrameBytes);
  while (std::fread(frame.data(), 1, frame.size(), stdin) == frame.size()) {
    const auto found = own_perception::centreline(own_perception::paint(frame.data()));
    std::printf("%d %.17g %.17g\n", found.valid, found.cross_track_error, found.heading_error);
  }
}
