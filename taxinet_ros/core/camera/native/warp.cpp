// Resamples a camera frame to the picture of a virtual camera.

#include "warp.hpp"

#include <algorithm>
#include <array>

#include "luma.hpp"

namespace pixels {
namespace {

constexpr int kSamples = 16, kCorners = 4;
constexpr int kWarpBits = 2 * kStepBits + 4;  // the weights of an element add up to 2^14
static_assert(kSamples << (2 * kStepBits) == 1 << kWarpBits);

}  // namespace

Warp::Warp(int height, int width, const Whole &places, int unseen)
    : height_(height), width_(width), first_row_(height), last_row_(-1) {
    require(places.ndim() == 4 && places.shape(2) == kSamples && places.shape(3) == 2,
            "places are (rows, columns, 16, 2)");
    require(height >= 2 && width >= kTap && 0 <= unseen && unseen <= 255,
            "a frame has two rows and four columns");
    out_height_ = static_cast<int>(places.shape(0));
    out_width_ = static_cast<int>(places.shape(1));
    const int count = out_height_ * out_width_;
    starts_.reserve(count + 1);
    base_.reserve(count);
    for (int i = 0; i < count; ++i) {
        starts_.push_back(static_cast<std::int32_t>(taps_.size()));
        add_pixel(places.data() + 2 * kSamples * i, unseen);
    }
    starts_.push_back(static_cast<std::int32_t>(taps_.size()));
    grey_.resize(static_cast<std::size_t>(height) * width);
}

void Warp::add_pixel(const std::int32_t *places, int unseen) {
    std::array<std::pair<std::int32_t, std::int32_t>, kSamples * kCorners> found;
    int count = 0, beside = 0;
    for (int sample = 0; sample < kSamples; ++sample) {
        const std::int32_t u = places[2 * sample], v = places[2 * sample + 1];
        if (u < 0 || v < 0 || u > (width_ - 1) * kSteps || v > (height_ - 1) * kSteps) {
            beside += kWhole;
            continue;
        }
        // The last row and column have nothing beyond them: they are the second of two.
        const std::int32_t column = lesser(u >> kStepBits, width_ - 2);
        const std::int32_t row = lesser(v >> kStepBits, height_ - 2);
        const std::int32_t right = u - column * kSteps, low = v - row * kSteps;
        const std::int32_t at = row * width_ + column;
        found[count++] = {at, (kSteps - right) * (kSteps - low)};
        found[count++] = {at + 1, right * (kSteps - low)};
        found[count++] = {at + width_, (kSteps - right) * low};
        found[count++] = {at + width_ + 1, right * low};
        first_row_ = lesser(first_row_, row);
        last_row_ = greater(last_row_, row + 1);
    }
    base_.push_back(beside * unseen + (1 << (kWarpBits - 1)));
    std::sort(found.begin(), found.begin() + count);
    const std::int32_t last = height_ * width_ - kTap;
    Tap *tap = nullptr;
    for (int i = 0; i < count; ++i) {
        const auto [at, weight] = found[i];
        if (weight == 0) {
            continue;
        }
        if (tap == nullptr || at >= tap->offset + kTap) {
            taps_.push_back({lesser(at, last), {}});
            tap = &taps_.back();
        }
        std::int16_t &sum = tap->weight[at - tap->offset];
        sum = static_cast<std::int16_t>(sum + weight);  // at most 2^14
    }
}

Bytes Warp::look(const Bytes &frame) {
    require(frame.ndim() == 3 && frame.shape(0) == height_ && frame.shape(1) == width_ &&
                frame.shape(2) == kChannels,
            "a frame of the size that was said");
    if (first_row_ <= last_row_) {
        grey_codes(frame.data(first_row_), (last_row_ - first_row_ + 1) * width_,
                   grey_.data() + static_cast<std::size_t>(first_row_) * width_);
    }
    Bytes picture({out_height_, out_width_});
    std::uint8_t *out = picture.mutable_data();
    const std::uint8_t *grey = grey_.data();
    const int count = out_height_ * out_width_;
    const Tap *tap = taps_.data();
    for (int i = 0; i < count; ++i) {
        std::int32_t sum = base_[i];
        for (const Tap *end = taps_.data() + starts_[i + 1]; tap < end; ++tap) {
            const std::uint8_t *from = grey + tap->offset;
            for (int k = 0; k < kTap; ++k) {
                sum += from[k] * tap->weight[k];
            }
        }
        out[i] = static_cast<std::uint8_t>(sum >> kWarpBits);
    }
    return picture;
}

}  // namespace pixels
