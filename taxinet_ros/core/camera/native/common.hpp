// Common definitions of the sources of taxinet_ros.core.camera.pixels.
//
// Equal input gives equal bytes on every processor: each operation is one IEEE 754 single-precision
// or integer operation; fused operations are explicit (fma), and the compiler must not fuse others
// (-ffp-contract=off in setup.py). Angles and exponentials, in double precision, come from the C
// library; their last bit is rounded away unless it decides a tie.

#pragma once

#include <pybind11/numpy.h>

#include <array>
#include <bit>
#include <cstdint>
#include <stdexcept>
#include <string>

static_assert(std::endian::native == std::endian::little);

// Loops over a row are also compiled for newer processors; the version is selected at start-up.
// PLAIN disables all processor-specific code; the tests compare both.
#if defined(PLAIN)
#define FOR_EACH_PROCESSOR
#elif defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__) && __GNUC__ >= 12
#define WITH_CLONES
#define FOR_EACH_PROCESSOR \
    __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define FOR_EACH_PROCESSOR
#endif
#define INLINE inline __attribute__((always_inline))

// Marks a loop with independent iterations: none reads what another writes.
#if defined(__clang__)
#define INDEPENDENT _Pragma("clang loop vectorize(assume_safety)")
#else
#define INDEPENDENT _Pragma("GCC ivdep")
#endif

namespace pixels {

namespace py = pybind11;

using Bytes = py::array_t<std::uint8_t, py::array::c_style>;
using Doubles = py::array_t<double, py::array::c_style>;
using Floats = py::array_t<float, py::array::c_style>;
using Whole = py::array_t<std::int32_t, py::array::c_style>;

// Rows of three.
using Matrix = std::array<std::array<double, 3>, 3>;

constexpr int kChannels = 3;

// Subpixel positions in steps of 1/32, as in OpenCV's bilinear interpolation.
constexpr int kStepBits = 5, kSteps = 1 << kStepBits, kWhole = kSteps * kSteps;

// Adding it to a number of magnitude < 2^22 rounds that to the nearest integer (ties to even),
// without an instruction that old processors lack.
constexpr float kRounder = 12582912.0F;
constexpr std::int32_t kRounderBits = 0x4B400000;

INLINE std::int32_t rounded(float number) {
    return std::bit_cast<std::int32_t>(number + kRounder) - kRounderBits;
}

INLINE float clipped(float number, float least, float most) {
    number = number < least ? least : number;
    return number > most ? most : number;
}

INLINE std::int32_t lesser(std::int32_t a, std::int32_t b) { return a < b ? a : b; }
INLINE std::int32_t greater(std::int32_t a, std::int32_t b) { return a > b ? a : b; }

// Of positive numbers, whose bits are in their order: compilers find no minimum of what was bits.
INLINE float lesser(float a, float b) {
    const auto bits_a = std::bit_cast<std::int32_t>(a), bits_b = std::bit_cast<std::int32_t>(b);
    return std::bit_cast<float>(lesser(bits_a, bits_b));
}
INLINE float greater(float a, float b) {
    const auto bits_a = std::bit_cast<std::int32_t>(a), bits_b = std::bit_cast<std::int32_t>(b);
    return std::bit_cast<float>(greater(bits_a, bits_b));
}

INLINE std::int32_t within(std::int32_t number, std::int32_t most) {
    return lesser(number < 0 ? 0 : number, most);
}

// Nearest code, 0 to 255.
INLINE std::uint8_t code_of(float number) {
    return static_cast<std::uint8_t>(within(rounded(number), 255));
}

// Raises ValueError in Python.
inline void require(bool holds, const char *what, const char *more = "") {
    if (!holds) {
        throw std::invalid_argument(std::string("pixels: ") + what + more);
    }
}

inline Matrix matrix_of(const Doubles &numbers, const char *what) {
    require(numbers.ndim() == 2 && numbers.shape(0) == 3 && numbers.shape(1) == 3, what);
    Matrix matrix;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            matrix[i][j] = numbers.at(i, j);
        }
    }
    return matrix;
}

}  // namespace pixels
