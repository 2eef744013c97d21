// Grey level of a colour: ITU-R BT.601's luma in 15-bit fixed point, as OpenCV's RGB2GRAY.

#pragma once

#include "common.hpp"

namespace pixels {

// Codes of so many pixels, three bytes each.
void grey_codes(const std::uint8_t *colours, int count, std::uint8_t *grey);

}  // namespace pixels
