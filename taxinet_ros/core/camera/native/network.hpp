#pragma once

#include <vector>

#include "common.hpp"

namespace pixels {

// As many output channels as are computed side by side: a register of AVX-512, two of AVX2.
constexpr int kLanes = 16;

struct alignas(sizeof(float) * kLanes) Lanes {
    float number[kLanes];
};

// A convolution, weights (rows, columns, input channels, output channels); a dense layer is one
// whose kernel is as large as its input.
struct Convolution {
    int rows, columns, inputs, outputs, stride, padding;
    bool rectified;
    std::vector<Lanes> bias;    // by block of output channels
    std::vector<Lanes> weight;  // by block, then by position in the kernel and input channel

    Convolution(const Floats &weights, const Floats &biases, int stride, int padding, bool rectified);

    int blocks() const { return static_cast<int>(bias.size()); }
    int taps() const { return rows * columns * inputs; }
};

class Network {
  public:
    Network(int height, int width, std::vector<Convolution> layers);

    Floats infer(const Floats &pictures);

  private:
    // Input of a layer, with its padding: rows of columns of channels.
    struct Plane {
        int height, width, channels;
        std::vector<float> numbers;
    };

    int height_, width_;
    std::vector<Convolution> layers_;
    std::vector<Plane> planes_;
};

}  // namespace pixels
