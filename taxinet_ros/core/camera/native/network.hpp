#pragma once

#include <vector>

#include "common.hpp"

namespace pixels {

// As many output channels as are computed side by side: a register of AVX-512, two of AVX2.
constexpr int kLanes = 16;

// As many blocks of these as have accumulators, and as many groups of inputs as one word marks.
constexpr int kMostBlocks = 6, kMarks = 4;

struct alignas(sizeof(float) * kLanes) Lanes {
    float number[kLanes];
};

// A convolution, weights (rows, columns, input channels, output channels); a dense layer is one
// whose kernel is as large as its input.
struct Convolution {
    int rows, columns, inputs, outputs, stride, padding;
    bool rectified;
    bool by_bits;               // whether products of zeros are left out
    std::vector<Lanes> bias;    // by block of output channels
    std::vector<Lanes> weight;  // by block, position in the kernel and input channel; or block last

    Convolution(const Floats &weights, const Floats &biases, int stride, int padding, bool rectified);

    int blocks() const { return static_cast<int>(bias.size()); }
    int taps() const { return rows * columns * inputs; }
};

// Input of a layer, with its padding: rows of columns of channels.
struct Plane {
    int height, width, channels, padding;
    std::vector<Lanes> numbers;
    std::vector<std::uint16_t> marks;  // a bit for each number, set if that is not zero

    std::ptrdiff_t stride() const { return static_cast<std::ptrdiff_t>(width) * channels; }
    const float *row(int v) const { return numbers.front().number + v * stride(); }

    // Without padding.
    int inner_height() const { return height - 2 * padding; }
    int inner_width() const { return width - 2 * padding; }
    float *inner_row(int v) {
        return numbers.front().number + (v + padding) * stride() + padding * channels;
    }
};

class Network {
  public:
    Network(int height, int width, std::vector<Convolution> layers);

    Floats infer(const Floats &pictures);

  private:
    int height_, width_;
    std::vector<Convolution> layers_;
    std::vector<Plane> planes_;
};

}  // namespace pixels
