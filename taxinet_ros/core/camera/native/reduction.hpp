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

constexpr int kMostTaps = 3, kEight = 8, kCodes = 16;

// Which of 16 codes are the sources of eight elements, by tap; the first two are side by side.
struct alignas(kCodes) Taken {
    std::uint8_t by_tap[kMostTaps + 1][kEight];
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
    std::vector<Taken> taken_;
    std::vector<std::uint8_t> grey_;
    std::vector<float> row_, sum_;
};

}  // namespace pixels
