#pragma once

#include <utility>
#include <vector>

#include "common.hpp"

namespace pixels {

// Resamples frames to grey images. Every element is the mean of samples, each interpolated between
// four pixels; which pixels count how much is worked out once, in whole numbers.
class Warp {
  public:
    // Places: positions of the samples in the frame, (rows, columns, 16, 2), across and down, in
    // steps of 1/32 pixel. One outside the frame has the grey level `unseen`.
    Warp(int height, int width, const Whole &places, int unseen);

    Bytes look(const Bytes &frame);

  private:
    void add_pixel(const std::int32_t *places, int unseen);

    // Pixels side by side that are weighed together.
    static constexpr int kTap = 4;
    struct Tap {
        std::int32_t offset;
        std::int16_t weight[kTap];
    };

    int height_, width_, out_height_, out_width_;
    int first_row_, last_row_;           // rows of the frame that are used
    std::vector<std::int32_t> starts_;   // of each element's taps, and their end
    std::vector<std::int32_t> base_;     // of each element: what no pixel contributes, and rounding
    std::vector<Tap> taps_;
    std::vector<std::uint8_t> grey_;
};

}  // namespace pixels
