// Images that are written to in place.

#pragma once

#include "common.hpp"

namespace pixels {

// An image or a part of one: its rows may be non-contiguous, the pixels of a row may not.
using Picture = py::array_t<std::uint8_t>;

// Rows of an image or a part of one, with three contiguous bytes per pixel.
struct Rows {
    std::uint8_t *first;
    std::ptrdiff_t stride;
    int count, width;

    explicit Rows(Picture &picture) {
        require(picture.ndim() == 3 && picture.shape(2) == kChannels && picture.strides(2) == 1 &&
                    picture.strides(1) == kChannels,
                "a picture is (rows, columns, 3), its pixels side by side");
        first = picture.mutable_data();
        stride = picture.strides(0);
        count = static_cast<int>(picture.shape(0));
        width = static_cast<int>(picture.shape(1));
    }

    std::uint8_t *at(int row) const { return first + row * stride; }
    int bytes() const { return width * kChannels; }
};

}  // namespace pixels
