#pragma once

#include <utility>
#include <vector>

#include "common.hpp"

namespace pixels {

// Source elements and weights of each element of a reduced row.
struct Shares {
    int from, count, taps;
    std::vector<std::int32_t> first;
    std::vector<float> weight;  // by tap, then by output element

    Shares(int from, int to);
};

class Reduction {
  public:
    // Bands from the top of the frame: number of frame rows and of output rows.
    Reduction(int height, int width, std::vector<std::pair<int, int>> bands, int columns);

    Bytes reduce(const Bytes &frame);

  private:
    int height_, width_;
    Shares columns_;
    std::vector<Shares> rows_;
    int out_height_;
    std::vector<float> grey_, row_, sum_;
};

}  // namespace pixels
