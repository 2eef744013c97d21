// Reduces a camera frame to the network's grey image, in bands that are averaged with different row
// ratios; bit-identical to OpenCV's RGB2GRAY and INTER_AREA.

#include "reduction.hpp"

#include <algorithm>
#include <cmath>

#include "luma.hpp"
#include "vectors.hpp"

namespace pixels {
namespace {

INLINE float average(const std::uint8_t *grey, const Shares &columns, int u) {
    const std::uint8_t *from = grey + columns.first[u];
    const float *weight = columns.weight.data() + u;
    const int count = columns.count;
    const float two = static_cast<float>(from[0]) * weight[0] +
                      static_cast<float>(from[1]) * weight[count];
    return two + static_cast<float>(from[2]) * weight[2 * count];
}

#if defined(WITH_VECTORS)

AVX2 INLINE __m256 weighted(__m128i codes, const float *weight) {
    return _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(codes)), _mm256_loadu_ps(weight));
}

// Averages eight elements at a time, where their sources are within 16 codes. Returns the first
// element that is not processed.
AVX2 int average_eights(const std::uint8_t *grey, const Shares &columns,
                        const std::vector<Taken> &taken, float *row) {
    const float *weight = columns.weight.data();
    const int count = columns.count;
    int u = 0;
    for (const Taken &eight : taken) {
        const __m128i codes =
            _mm_loadu_si128(reinterpret_cast<const __m128i *>(grey + columns.first[u]));
        const __m128i two = _mm_shuffle_epi8(
            codes, _mm_load_si128(reinterpret_cast<const __m128i *>(eight.by_tap[0])));
        const __m128i third = _mm_shuffle_epi8(
            codes, _mm_load_si128(reinterpret_cast<const __m128i *>(eight.by_tap[2])));
        const __m256 sum =
            _mm256_add_ps(weighted(two, weight + u),
                          weighted(_mm_srli_si128(two, kEight), weight + count + u));
        _mm256_storeu_ps(row + u, _mm256_add_ps(sum, weighted(third, weight + 2 * count + u)));
        u += kEight;
    }
    return u;
}

#endif

// Sources of elements eight by eight, up to the first eight that are too far apart.
std::vector<Taken> taken_by(const Shares &columns) {
    std::vector<Taken> taken;
    for (int u = 0; u + kEight <= columns.count; u += kEight) {
        if (columns.first[u + kEight - 1] + kMostTaps - columns.first[u] > kCodes) {
            break;
        }
        Taken eight{};
        for (int tap = 0; tap < kMostTaps; ++tap) {
            for (int i = 0; i < kEight; ++i) {
                eight.by_tap[tap][i] =
                    static_cast<std::uint8_t>(columns.first[u + i] - columns.first[u] + tap);
            }
        }
        taken.push_back(eight);
    }
    return taken;
}

void average_columns(const std::uint8_t *grey, const Shares &columns,
                     const std::vector<Taken> &taken, float *row) {
    int u = 0;
#if defined(WITH_VECTORS)
    static const bool by_eight = __builtin_cpu_supports("avx2");
    if (by_eight) {
        u = average_eights(grey, columns, taken, row);
    }
#endif
    for (; u < columns.count; ++u) {
        row[u] = average(grey, columns, u);
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
    taken_ = taken_by(columns_);
    grey_.assign(static_cast<std::size_t>(width_) + kCodes, 0);
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
                    grey_codes(frame.data(row), width_, grey_.data());
                    average_columns(grey_.data(), columns_, taken_, row_.data());
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
