// Reduces a camera frame to the network's grey image, in bands that are averaged with different row
// ratios; bit-identical to OpenCV's RGB2GRAY and INTER_AREA.

#include "reduction.hpp"

#include <algorithm>
#include <cmath>

#include "luma.hpp"

namespace pixels {
namespace {

constexpr int kMostTaps = 3;

FOR_EACH_PROCESSOR void grey_row(const std::uint8_t *__restrict colours, int width,
                                 float *__restrict grey) {
    for (int u = 0; u < width; ++u) {
        grey[u] = static_cast<float>(luma(colours + kChannels * u));
    }
}

FOR_EACH_PROCESSOR void average_columns(const float *__restrict grey, const Shares &columns,
                                        float *__restrict row) {
    const int count = columns.count;
    const std::int32_t *__restrict first = columns.first.data();
    const float *__restrict weight = columns.weight.data();
    INDEPENDENT
    for (int u = 0; u < count; ++u) {
        const float *from = grey + first[u];
        const float two = from[0] * weight[u] + from[1] * weight[count + u];
        row[u] = two + from[2] * weight[2 * count + u];
    }
}

FOR_EACH_PROCESSOR void add_row(const float *__restrict row, float weight, int count,
                                float *__restrict sum) {
    for (int u = 0; u < count; ++u) {
        sum[u] += row[u] * weight;
    }
}

FOR_EACH_PROCESSOR void round_row(const float *__restrict sum, int count,
                                  std::uint8_t *__restrict out) {
    for (int u = 0; u < count; ++u) {
        out[u] = code_of(sum[u]);
    }
}

}  // namespace

Shares::Shares(int from, int to) : from(from), count(to), taps(0), first(to) {
    // In double precision and in this order, as in OpenCV's computeResizeAreaTab.
    const double scale = static_cast<double>(from) / to;
    std::vector<std::vector<float>> weights(to);
    for (int i = 0; i < to; ++i) {
        const double start = i * scale, end = start + scale;
        const double size = std::min(scale, from - start);
        int whole = static_cast<int>(std::ceil(start));
        const int last = std::min(static_cast<int>(std::floor(end)), from - 1);
        whole = std::min(whole, last);
        first[i] = whole;
        if (whole - start > 1e-3) {
            first[i] = whole - 1;
            weights[i].push_back(static_cast<float>((whole - start) / size));
        }
        for (int j = whole; j < last; ++j) {
            weights[i].push_back(static_cast<float>(1.0 / size));
        }
        if (end - last > 1e-3) {
            weights[i].push_back(
                static_cast<float>(std::min(std::min(end - last, 1.0), size) / size));
        }
        taps = std::max(taps, static_cast<int>(weights[i].size()));
    }
    // Elements with fewer taps are padded with zero weights.
    weight.assign(static_cast<std::size_t>(taps) * to, 0.0F);
    for (int i = 0; i < to; ++i) {
        for (std::size_t tap = 0; tap < weights[i].size(); ++tap) {
            weight[tap * to + i] = weights[i][tap];
        }
    }
}

Reduction::Reduction(int height, int width, std::vector<std::pair<int, int>> bands, int columns)
    : height_(height), width_(width), columns_(width, columns), out_height_(0) {
    int from = 0;
    for (const auto &[rows, out_rows] : bands) {
        require(rows >= out_rows && out_rows > 0, "a band is reduced");
        rows_.emplace_back(rows, out_rows);
        from += rows;
        out_height_ += out_rows;
    }
    require(from == height && width >= columns && columns > 0, "bands make up the frame");
    // average_columns uses three source elements per output element.
    require(columns_.taps <= kMostTaps, "a row is reduced by no more than a half");
    columns_.weight.resize(static_cast<std::size_t>(kMostTaps) * columns, 0.0F);
    grey_.assign(static_cast<std::size_t>(width_) + kMostTaps, 0.0F);
    row_.resize(columns_.count);
    sum_.resize(columns_.count);
}

Bytes Reduction::reduce(const Bytes &frame) {
    require(frame.ndim() == 3 && frame.shape(0) == height_ && frame.shape(1) == width_ &&
                frame.shape(2) == kChannels,
            "a frame of the size that was said");
    const int count = columns_.count;
    Bytes picture({out_height_, count});
    std::uint8_t *out = picture.mutable_data();
    int from = 0, averaged = -1;
    for (const Shares &band : rows_) {
        for (int v = 0; v < band.count; ++v, out += count) {
            std::fill(sum_.begin(), sum_.end(), 0.0F);
            for (int tap = 0; tap < band.taps; ++tap) {
                const float weight = band.weight[static_cast<std::size_t>(tap) * band.count + v];
                if (weight == 0.0F) {
                    break;
                }
                // Two output rows may share a frame row.
                const int row = from + band.first[v] + tap;
                if (row != averaged) {
                    grey_row(frame.data(row), width_, grey_.data());
                    average_columns(grey_.data(), columns_, row_.data());
                    averaged = row;
                }
                add_row(row_.data(), weight, count, sum_.data());
            }
            round_row(sum_.data(), count, out);
        }
        from += band.from;
    }
    return picture;
}

}  // namespace pixels
