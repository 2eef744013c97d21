// What the sources of taxinet_ros.core.camera.pixels share.
//
// Equal input gives equal bytes on every processor: each operation is one IEEE 754 single precision
// operation or one on whole numbers; where two are fused it says fma, and the compiler may fuse no
// others (-ffp-contract=off in setup.py). Angles and exponentials, in double precision, are the C
// library's, whose last bit is rounded away unless it decides a tie.

#pragma once

#include <pybind11/numpy.h>

#include <bit>
#include <cstdint>
#include <stdexcept>
#include <string>

static_assert(std::endian::native == std::endian::little);

// A loop over a row is compiled for newer processors too; which is taken is decided at start. PLAIN
// leaves out all that is written for one kind of processor: the tests compare the two.
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

// Before a loop whose turns may be taken at once: what is written is read by none of them.
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

constexpr int kChannels = 3;

// A position between pixels in steps of 1/32, as OpenCV's bilinear interpolation has it.
constexpr int kStepBits = 5, kSteps = 1 << kStepBits, kWhole = kSteps * kSteps;

// Added to a number below 2^22 in size it pushes all but the whole part out of a float: rounding to
// the nearest even, without an instruction that old processors lack.
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

INLINE std::int32_t within(std::int32_t number, std::int32_t most) {
    return lesser(number < 0 ? 0 : number, most);
}

// The nearest of the codes 0 to 255.
INLINE std::uint8_t code_of(float number) {
    return static_cast<std::uint8_t>(within(rounded(number), 255));
}

// Raises ValueError in Python.
inline void require(bool holds, const char *what, const char *more = "") {
    if (!holds) {
        throw std::invalid_argument(std::string("pixels: ") + what + more);
    }
}

}  // namespace pixels
