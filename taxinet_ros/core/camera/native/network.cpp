// Inference of small convolutional networks. Each output has one accumulator, which starts at its
// bias and adds one rounded product at a time, by row, column and input channel of the kernel. So
// the order of additions, and with it each bit, is the same for registers of any width.

#include "network.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

namespace pixels {
namespace {

// A register of so many numbers, and what is read and written by one.
template <int width>
struct Vector {
    typedef float Register __attribute__((vector_size(sizeof(float) * width)));
    typedef float Memory __attribute__((vector_size(sizeof(float) * width),
                                        aligned(alignof(float)), may_alias));
};

// Outputs of `count` columns, which are `step` floats apart in the input.
template <int width, int count>
INLINE void convolve(const float *input, std::ptrdiff_t row, std::ptrdiff_t step,
                     const Convolution &layer, int block, float *output) {
    using Register = typename Vector<width>::Register;
    using Memory = typename Vector<width>::Memory;
    constexpr int kParts = kLanes / width;
    const auto *bias = reinterpret_cast<const Memory *>(&layer.bias[block]);
    const auto *weights = reinterpret_cast<const Memory *>(
        &layer.weight[static_cast<std::size_t>(block) * layer.taps()]);
    const int run = layer.columns * layer.inputs;
    // Loops over sums are unrolled, for registers have no index.
    Register sum[count][kParts], weight[kParts];
#pragma GCC unroll 16
    for (int u = 0; u < count; ++u) {
#pragma GCC unroll 16
        for (int part = 0; part < kParts; ++part) {
            sum[u][part] = bias[part];
        }
    }
    for (int v = 0; v < layer.rows; ++v) {
        const float *from = input + v * row;
        for (int i = 0; i < run; ++i, weights += kParts) {
#pragma GCC unroll 16
            for (int part = 0; part < kParts; ++part) {
                weight[part] = weights[part];
            }
#pragma GCC unroll 16
            for (int u = 0; u < count; ++u) {
#pragma GCC unroll 16
                for (int part = 0; part < kParts; ++part) {
                    sum[u][part] += from[u * step + i] * weight[part];
                }
            }
        }
    }
    const int outputs = std::min(kLanes, layer.outputs - block * kLanes);
#pragma GCC unroll 16
    for (int u = 0; u < count; ++u, output += layer.outputs) {
        Lanes answer;
#pragma GCC unroll 16
        for (int part = 0; part < kParts; ++part) {
            Register number = sum[u][part];
            if (layer.rectified) {
                number = number < 0 ? Register{} : number;
            }
            reinterpret_cast<Memory *>(answer.number)[part] = number;
        }
        if (outputs == kLanes) {
            std::memcpy(output, &answer, sizeof(answer));
        } else {
            std::memcpy(output, &answer, sizeof(float) * outputs);
        }
    }
}

template <int width, int count>
INLINE void convolve_all(const float *input, std::ptrdiff_t row, const Convolution &layer,
                         int block, int columns, float *output) {
    const std::ptrdiff_t step = static_cast<std::ptrdiff_t>(layer.stride) * layer.inputs;
    int u = 0;
    for (; u + count <= columns; u += count) {
        convolve<width, count>(input + u * step, row, step, layer, block,
                               output + u * layer.outputs);
    }
    for (; u < columns; ++u) {
        convolve<width, 1>(input + u * step, row, step, layer, block, output + u * layer.outputs);
    }
}

// One row of a block of output channels, with as many accumulators as the processor has registers
// for.
using ConvolveRow = void(const float *input, std::ptrdiff_t row, const Convolution &layer,
                         int block, int columns, float *output);

void convolve_row(const float *input, std::ptrdiff_t row, const Convolution &layer, int block,
                  int columns, float *output) {
    convolve_all<4, 3>(input, row, layer, block, columns, output);
}

#if defined(WITH_CLONES)

__attribute__((target("arch=x86-64-v3"))) void convolve_row_v3(
    const float *input, std::ptrdiff_t row, const Convolution &layer, int block, int columns,
    float *output) {
    convolve_all<8, 6>(input, row, layer, block, columns, output);
}

__attribute__((target("arch=x86-64-v4"))) void convolve_row_v4(
    const float *input, std::ptrdiff_t row, const Convolution &layer, int block, int columns,
    float *output) {
    convolve_all<16, 6>(input, row, layer, block, columns, output);
}

#endif

ConvolveRow *fastest() {
#if defined(WITH_CLONES)
    if (__builtin_cpu_supports("x86-64-v4")) {
        return convolve_row_v4;
    }
    if (__builtin_cpu_supports("x86-64-v3")) {
        return convolve_row_v3;
    }
#endif
    return convolve_row;
}

}  // namespace

Convolution::Convolution(const Floats &weights, const Floats &biases, int stride, int padding,
                         bool rectified)
    : stride(stride), padding(padding), rectified(rectified) {
    require(weights.ndim() == 4 && biases.ndim() == 1 && weights.shape(3) == biases.shape(0) &&
                weights.size() > 0,
            "a layer has weights (rows, columns, inputs, outputs) and biases (outputs,)");
    require(stride > 0 && padding >= 0, "a layer has a stride, and a padding or none");
    rows = static_cast<int>(weights.shape(0));
    columns = static_cast<int>(weights.shape(1));
    inputs = static_cast<int>(weights.shape(2));
    outputs = static_cast<int>(weights.shape(3));
    const int blocks = (outputs + kLanes - 1) / kLanes;
    bias.assign(blocks, Lanes{});
    weight.assign(static_cast<std::size_t>(blocks) * taps(), Lanes{});
    for (int c = 0; c < outputs; ++c) {
        const std::size_t block = c / kLanes, lane = c % kLanes;
        bias[block].number[lane] = biases.data()[c];
        for (int tap = 0; tap < taps(); ++tap) {
            weight[block * taps() + tap].number[lane] =
                weights.data()[static_cast<std::size_t>(tap) * outputs + c];
        }
    }
}

Network::Network(int height, int width, std::vector<Convolution> layers)
    : height_(height), width_(width), layers_(std::move(layers)) {
    require(height > 0 && width > 0 && !layers_.empty(), "a network has an input and layers");
    int channels = layers_.front().inputs;
    const auto add_plane = [&](int padding) {
        const int rows = height + 2 * padding, columns = width + 2 * padding;
        planes_.push_back({rows, columns, channels,
                           std::vector<float>(static_cast<std::size_t>(rows) * columns * channels)});
    };
    for (const Convolution &layer : layers_) {
        require(layer.inputs == channels, "a layer takes what the one before it gives");
        add_plane(layer.padding);
        height += 2 * layer.padding - layer.rows;
        width += 2 * layer.padding - layer.columns;
        require(height >= 0 && width >= 0, "a kernel fits into its input");
        height = height / layer.stride + 1;
        width = width / layer.stride + 1;
        channels = layer.outputs;
    }
    require(height == 1 && width == 1, "the last layer gives one number for each output");
    add_plane(0);
}

Floats Network::infer(const Floats &pictures) {
    const Convolution &first = layers_.front();
    require(pictures.ndim() == 4 && pictures.shape(1) == height_ && pictures.shape(2) == width_ &&
                pictures.shape(3) == first.inputs,
            "pictures (N, height, width, channels) of the size that was said");
    const py::ssize_t count = pictures.shape(0);
    static ConvolveRow *const convolve = fastest();
    Floats answers({count, static_cast<py::ssize_t>(layers_.back().outputs)});
    const std::size_t row = static_cast<std::size_t>(width_) * first.inputs;
    for (py::ssize_t picture = 0; picture < count; ++picture) {
        Plane &input = planes_.front();
        for (int v = 0; v < height_; ++v) {
            const int at = (v + first.padding) * input.width + first.padding;
            std::copy_n(pictures.data(picture) + v * row, row,
                        input.numbers.data() + at * first.inputs);
        }
        for (std::size_t i = 0; i < layers_.size(); ++i) {
            const Convolution &layer = layers_[i];
            const Plane &from = planes_[i];
            Plane &to = planes_[i + 1];
            const int edge = i + 1 < layers_.size() ? layers_[i + 1].padding : 0;
            const std::ptrdiff_t from_row = static_cast<std::ptrdiff_t>(from.width) * from.channels;
            for (int block = 0; block < layer.blocks(); ++block) {
                for (int v = 0; v < to.height - 2 * edge; ++v) {
                    const int at = (v + edge) * to.width + edge;
                    convolve(from.numbers.data() + v * layer.stride * from_row, from_row, layer,
                             block, to.width - 2 * edge,
                             to.numbers.data() + at * to.channels + block * kLanes);
                }
            }
        }
        std::copy_n(planes_.back().numbers.data(), answers.shape(1), answers.mutable_data(picture));
    }
    return answers;
}

}  // namespace pixels
