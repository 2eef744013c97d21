// Inference of small convolutional networks. Each output has one accumulator, which starts at its
// bias and adds one rounded product at a time, by row, column and input channel of the kernel. So
// the order of additions, and with it each bit, is the same for registers of any width.
//
// Two thirds of what a rectified layer gives are zeros, whose products change no sum. So layers
// that can (Convolution::by_bits) read only inputs that are not zero, which planes mark by bits.

#include "network.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "vectors.hpp"

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

// Positions in one kernel row from which a row of outputs is increased: at most 64, so that one
// word has a bit for each, and their weights stay in the cache.
struct Span {
    const float *input;
    const std::uint16_t *marks;  // of 16 inputs each
    std::uint64_t bits;
    std::ptrdiff_t step;  // inputs from one column of outputs to the next
    const Lanes *weights;
    int blocks;  // of weights for each position
    std::ptrdiff_t outputs;
};

// Adds the products of inputs that are not zero to `count` columns of `blocks` blocks of outputs.
template <int width, int blocks, int count>
INLINE void add_products(const Span &span, int column, float *output) {
    using Register = typename Vector<width>::Register;
    using Memory = typename Vector<width>::Memory;
    constexpr int kParts = blocks * kLanes / width;
    const float *input = span.input + column * span.step;
    std::uint64_t bits = 0;
#pragma GCC unroll 16
    for (int u = 0; u < count; ++u) {
        std::uint64_t some;
        std::memcpy(&some, span.marks + (column + u) * span.step / kLanes, sizeof(some));
        bits |= some;
    }
    bits &= span.bits;
    Register sum[count][kParts];
#pragma GCC unroll 16
    for (int u = 0; u < count; ++u) {
        const auto *before = reinterpret_cast<const Memory *>(output + u * span.outputs);
#pragma GCC unroll 16
        for (int part = 0; part < kParts; ++part) {
            sum[u][part] = before[part];
        }
    }
    for (; bits != 0; bits &= bits - 1) {
        const int i = std::countr_zero(bits);
        const auto *weights = reinterpret_cast<const Memory *>(span.weights + i * span.blocks);
#pragma GCC unroll 16
        for (int part = 0; part < kParts; ++part) {
            const Register weight = weights[part];
#pragma GCC unroll 16
            for (int u = 0; u < count; ++u) {
                sum[u][part] += input[u * span.step + i] * weight;
            }
        }
    }
#pragma GCC unroll 16
    for (int u = 0; u < count; ++u) {
        auto *after = reinterpret_cast<Memory *>(output + u * span.outputs);
#pragma GCC unroll 16
        for (int part = 0; part < kParts; ++part) {
            after[part] = sum[u][part];
        }
    }
}

template <int width, int blocks>
INLINE void add_row(const Span &span, int columns, float *output) {
    // Fewer sums than these would wait for each other.
    constexpr int count = width == kLanes && blocks <= 2 ? 2 : 1;
    int u = 0;
    for (; u + count <= columns; u += count) {
        add_products<width, blocks, count>(span, u, output + u * span.outputs);
    }
    for (; u < columns; ++u) {
        add_products<width, blocks, 1>(span, u, output + u * span.outputs);
    }
}

template <int width>
INLINE void add_all(const Span &span, int columns, int blocks, float *output) {
    switch (blocks) {
        case 1:
            return add_row<width, 1>(span, columns, output);
        case 2:
            return add_row<width, 2>(span, columns, output);
        case 3:
            return add_row<width, 3>(span, columns, output);
        case 4:
            return add_row<width, 4>(span, columns, output);
        case 5:
            return add_row<width, 5>(span, columns, output);
        default:
            return add_row<width, kMostBlocks>(span, columns, output);
    }
}

// Kernels of one kind of processor: one row of a block of output channels, with as many
// accumulators as the processor has registers for; and one row of at most kMostBlocks blocks, from
// a span.
using ConvolveRow = void(const float *input, std::ptrdiff_t row, const Convolution &layer,
                         int block, int columns, float *output);
using AddRow = void(const Span &span, int columns, int blocks, float *output);
struct Kernels {
    ConvolveRow *convolve;
    AddRow *add;
};

void convolve_row(const float *input, std::ptrdiff_t row, const Convolution &layer, int block,
                  int columns, float *output) {
    convolve_all<4, 3>(input, row, layer, block, columns, output);
}

void add_row_of(const Span &span, int columns, int blocks, float *output) {
    add_all<4>(span, columns, blocks, output);
}

#if defined(WITH_CLONES)

__attribute__((target("arch=x86-64-v3"))) void convolve_row_v3(
    const float *input, std::ptrdiff_t row, const Convolution &layer, int block, int columns,
    float *output) {
    convolve_all<8, 6>(input, row, layer, block, columns, output);
}

__attribute__((target("arch=x86-64-v3"))) void add_row_of_v3(const Span &span, int columns,
                                                             int blocks, float *output) {
    add_all<8>(span, columns, blocks, output);
}

__attribute__((target("arch=x86-64-v4"))) void convolve_row_v4(
    const float *input, std::ptrdiff_t row, const Convolution &layer, int block, int columns,
    float *output) {
    convolve_all<16, 6>(input, row, layer, block, columns, output);
}

__attribute__((target("arch=x86-64-v4"))) void add_row_of_v4(const Span &span, int columns,
                                                             int blocks, float *output) {
    add_all<16>(span, columns, blocks, output);
}

#endif

Kernels fastest() {
#if defined(WITH_CLONES)
    if (__builtin_cpu_supports("x86-64-v4")) {
        return {convolve_row_v4, add_row_of_v4};
    }
    if (__builtin_cpu_supports("x86-64-v3")) {
        return {convolve_row_v3, add_row_of_v3};
    }
#endif
    return {convolve_row, add_row_of};
}

#if defined(WITH_VECTORS)

AVX512 void mark_sixteens(Plane &plane, bool rectified) {
    const __m512 zero = _mm512_setzero_ps();
    for (std::size_t i = 0; i < plane.numbers.size(); ++i) {
        float *number = plane.numbers[i].number;
        const __m512 before = _mm512_load_ps(number);
        // The second operand is the result if one is NaN.
        const __m512 after = rectified ? _mm512_max_ps(zero, before) : before;
        _mm512_store_ps(number, after);
        plane.marks[i] = _mm512_cmp_ps_mask(after, zero, _CMP_NEQ_UQ);
    }
}

#endif

// Turns negative numbers to zero if asked, and marks those that are not zero.
void mark(Plane &plane, bool rectified) {
    if (plane.channels % kLanes != 0) {
        return;  // no layer asks for the marks, and this one is rectified already
    }
#if defined(WITH_VECTORS)
    static const bool by_sixteen = __builtin_cpu_supports("avx512bw");
    if (by_sixteen) {
        mark_sixteens(plane, rectified);
        return;
    }
#endif
    for (std::size_t i = 0; i < plane.numbers.size(); ++i) {
        float *number = plane.numbers[i].number;
        std::uint32_t bits = 0;
#if defined(WITH_VECTORS)
        for (int lane = 0; lane < kLanes; lane += 4) {
            const __m128 zero = _mm_setzero_ps(), before = _mm_load_ps(number + lane);
            // The second operand is the result if one is NaN.
            const __m128 after = rectified ? _mm_max_ps(zero, before) : before;
            _mm_store_ps(number + lane, after);
            bits |= static_cast<std::uint32_t>(_mm_movemask_ps(_mm_cmpneq_ps(after, zero))) << lane;
        }
#else
        for (int lane = 0; lane < kLanes; ++lane) {
            number[lane] = rectified && number[lane] < 0 ? 0 : number[lane];
            bits |= static_cast<std::uint32_t>(number[lane] != 0) << lane;
        }
#endif
        plane.marks[i] = static_cast<std::uint16_t>(bits);
    }
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
    // The product of zero and a number that is not finite is NaN.
    by_bits = inputs % kLanes == 0 && outputs % kLanes == 0 &&
              std::all_of(weights.data(), weights.data() + weights.size(),
                          [](float weight) { return std::isfinite(weight); });
    bias.assign(blocks, Lanes{});
    weight.assign(static_cast<std::size_t>(blocks) * taps(), Lanes{});
    for (int c = 0; c < outputs; ++c) {
        const int block = c / kLanes, lane = c % kLanes;
        // A sum is -0 only if all of it is: without zeros it would stay so.
        bias[block].number[lane] = by_bits ? biases.data()[c] + 0.0F : biases.data()[c];
        for (int tap = 0; tap < taps(); ++tap) {
            weight[by_bits ? tap * blocks + block : block * taps() + tap].number[lane] =
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
        const std::size_t count = static_cast<std::size_t>(rows) * columns * channels;
        // So many more as are read at once.
        planes_.push_back({rows, columns, channels, padding,
                           std::vector<Lanes>((count + kLanes - 1) / kLanes),
                           std::vector<std::uint16_t>(count / kLanes + 4)});
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

namespace {

// All outputs of a layer, one block of channels after the other.
void convolve(ConvolveRow *convolve_row, const Convolution &layer, const Plane &from, Plane &to) {
    for (int block = 0; block < layer.blocks(); ++block) {
        for (int v = 0; v < to.inner_height(); ++v) {
            convolve_row(from.row(v * layer.stride), from.stride(), layer, block,
                         to.inner_width(), to.inner_row(v) + block * kLanes);
        }
    }
}

// The same before rectification, one span of the kernel after the other.
void add_products(AddRow *add_row, const Convolution &layer, const Plane &from, Plane &to) {
    const int blocks = layer.blocks(), run = layer.columns * layer.inputs / kLanes;
    const int spans = (run + kMarks - 1) / kMarks;
    const int parts = (blocks + kMostBlocks - 1) / kMostBlocks;
    for (int v = 0; v < to.inner_height(); ++v) {
        for (int u = 0; u < to.inner_width(); ++u) {
            std::memcpy(to.inner_row(v) + u * layer.outputs, layer.bias.data(),
                        sizeof(Lanes) * blocks);
        }
    }
    Span span{};
    span.step = static_cast<std::ptrdiff_t>(layer.stride) * layer.inputs;
    span.blocks = blocks;
    span.outputs = layer.outputs;
    for (int part = 0; part < parts; ++part) {
        const int block = blocks * part / parts, end_block = blocks * (part + 1) / parts;
        for (int row = 0; row < layer.rows; ++row) {
            for (int i = 0; i < spans; ++i) {
                const int first = run * i / spans, end = run * (i + 1) / spans;
                span.bits = ~std::uint64_t{0} >> (kLanes * (kMarks - (end - first)));
                span.weights = layer.weight.data() + block +
                               static_cast<std::size_t>(row * run + first) * kLanes * blocks;
                for (int v = 0; v < to.inner_height(); ++v) {
                    span.input = from.row(v * layer.stride + row) + first * kLanes;
                    span.marks = from.marks.data() + (span.input - from.row(0)) / kLanes;
                    add_row(span, to.inner_width(), end_block - block,
                            to.inner_row(v) + block * kLanes);
                }
            }
        }
    }
}

}  // namespace

Floats Network::infer(const Floats &pictures) {
    const Convolution &first = layers_.front();
    require(pictures.ndim() == 4 && pictures.shape(1) == height_ && pictures.shape(2) == width_ &&
                pictures.shape(3) == first.inputs,
            "pictures (N, height, width, channels) of the size that was said");
    const py::ssize_t count = pictures.shape(0);
    static const Kernels kernels = fastest();
    Floats answers({count, static_cast<py::ssize_t>(layers_.back().outputs)});
    const std::size_t row = static_cast<std::size_t>(width_) * first.inputs;
    for (py::ssize_t picture = 0; picture < count; ++picture) {
        for (int v = 0; v < height_; ++v) {
            std::copy_n(pictures.data(picture) + v * row, row, planes_.front().inner_row(v));
        }
        mark(planes_.front(), false);
        for (std::size_t i = 0; i < layers_.size(); ++i) {
            const Convolution &layer = layers_[i];
            if (layer.by_bits) {
                add_products(kernels.add, layer, planes_[i], planes_[i + 1]);
            } else {
                convolve(kernels.convolve, layer, planes_[i], planes_[i + 1]);
            }
            mark(planes_[i + 1], layer.rectified);
        }
        std::copy_n(planes_.back().row(0), answers.shape(1), answers.mutable_data(picture));
    }
    return answers;
}

}  // namespace pixels
