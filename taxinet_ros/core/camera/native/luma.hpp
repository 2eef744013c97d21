// Grey level of a colour: ITU-R BT.601's luma in 15-bit fixed point, as OpenCV's RGB2GRAY.

#pragma once

#include "common.hpp"

namespace pixels {

INLINE int luma(const std::uint8_t *colour) {
    constexpr int kRed = 9798, kGreen = 19235, kBlue = 3735, kBits = 15;
    const int sum = kRed * colour[0] + kGreen * colour[1] + kBlue * colour[2];
    return (sum + (1 << (kBits - 1))) >> kBits;
}

}  // namespace pixels
