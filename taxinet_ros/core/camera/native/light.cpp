#include "light.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "vectors.hpp"

namespace pixels {
namespace {

// Share of a code in 255ths, rounded exactly (there are no ties).
INLINE std::uint8_t share_of(std::uint8_t code, std::uint8_t share) {
    const auto product = static_cast<std::uint16_t>(code * share + 128);
    return static_cast<std::uint8_t>(static_cast<std::uint16_t>(product + (product >> 8)) >> 8);
}

INLINE std::uint8_t sum_of(std::uint8_t a, std::uint8_t b) {
    const auto sum = static_cast<std::uint8_t>(a + b);
    return sum < a ? 255 : sum;
}

using Codes = std::array<std::uint8_t, kChannels>;

// Codes of a mask that are compared at once.
constexpr int kTogether = 8;

INLINE std::uint64_t eight_codes(const std::uint8_t *codes) {
    std::uint64_t eight;
    std::memcpy(&eight, codes, sizeof(eight));
    return eight;
}

// Nearest code, 0 to 255, without prior rounding to single precision.
std::uint8_t exact_code_of(double number) {
    return static_cast<std::uint8_t>(std::clamp(std::nearbyint(number), 0.0, 255.0));
}

Codes codes_of(const double *numbers) {
    return {exact_code_of(numbers[0]), exact_code_of(numbers[1]), exact_code_of(numbers[2])};
}

// Fills a row with one colour.
void fill_row(const Codes &colour, std::vector<std::uint8_t> &row) {
    std::memcpy(row.data(), colour.data(), kChannels);
    for (std::size_t filled = kChannels; filled < row.size(); filled *= 2) {
        std::memcpy(row.data() + filled, row.data(), std::min(filled, row.size() - filled));
    }
}

FOR_EACH_PROCESSOR void keep_shares(std::uint8_t *__restrict codes,
                                    const std::uint8_t *__restrict shares, int bytes) {
    for (int i = 0; i < bytes; ++i) {
        codes[i] = share_of(codes[i], shares[i]);
    }
}

FOR_EACH_PROCESSOR void veil_row(std::uint8_t *__restrict codes,
                                 const std::uint8_t *__restrict kept,
                                 const std::uint8_t *__restrict added, int bytes) {
    for (int i = 0; i < bytes; ++i) {
        codes[i] = sum_of(share_of(codes[i], kept[i]), added[i]);
    }
}

FOR_EACH_PROCESSOR void shine_row(std::uint8_t *__restrict codes, float strength,
                                  const float *__restrict across, const float *__restrict tint,
                                  int bytes) {
    for (int i = 0; i < bytes; ++i) {
        codes[i] = sum_of(codes[i], code_of(strength * across[i] * tint[i]));
    }
}

FOR_EACH_PROCESSOR void blend_row(std::uint8_t *__restrict codes,
                                  const std::uint8_t *__restrict mask, float share,
                                  const float *__restrict paint, int width) {
    for (int u = 0; u < width; ++u) {
        for (int c = 0; c < kChannels; ++c) {
            const auto code = static_cast<float>(codes[kChannels * u + c]);
            codes[kChannels * u + c] = code_of(code + share * mask[u] * (paint[c] - code));
        }
    }
}

// Adds a row of codes to sums.
FOR_EACH_PROCESSOR void add_row(const std::uint8_t *__restrict codes, int count,
                                std::uint16_t *__restrict sums) {
    for (int i = 0; i < count; ++i) {
        sums[i] = static_cast<std::uint16_t>(sums[i] + codes[i]);
    }
}

// Means of squares of pixels whose columns are summed up already. A sum is one of 16 bits, or has
// four of them: three codes, and how many pixels are drawn; for the others there is the background.
template <typename Sum, int kFiner>
FOR_EACH_PROCESSOR void average_row(const std::uint16_t *sums, int width, std::uint8_t *codes) {
    constexpr int kSums = sizeof(Sum) / sizeof(*sums), kCodes = kSums == 1 ? 1 : kChannels;
    constexpr int kCount = kFiner * kFiner;
    for (int u = 0; u < width; ++u) {
        Sum all = 0;
        for (int k = 0; k < kFiner; ++k) {
            Sum one;
            std::memcpy(&one, sums + (u * kFiner + k) * kSums, sizeof(one));
            all = static_cast<Sum>(all + one);
        }
        for (int c = 0; c < kCodes; ++c) {
            std::uint8_t &code = codes[u * kCodes + c];
            int sum = all >> (16 * c) & 0xFFFF;
            if (kSums > 1) {
                sum += (kCount - static_cast<int>(all >> 16 * kCodes)) * code;
            }
            // Half to even, but up from two by two pixels, as OpenCV does.
            const int odd = kFiner == 2 ? 1 : sum / kCount & 1;
            code = static_cast<std::uint8_t>((sum + kCount / 2 - 1 + odd) / kCount);
        }
    }
}

template <typename Sum>
auto averaging(int finer) {
    require(finer == 2 || finer == 4 || finer == 8, "a canvas is 2, 4 or 8 times finer");
    return finer == 8 ? average_row<Sum, 8> : finer == 4 ? average_row<Sum, 4> : average_row<Sum, 2>;
}

void require_mask(const Picture &mask, const Rows &rows) {
    require(mask.ndim() == 2 && mask.shape(0) == rows.count && mask.shape(1) == rows.width &&
                mask.strides(1) == 1,
            "a mask is as large as its part of the picture, its codes side by side");
}

#if defined(WITH_VECTORS)

// Processes a whole register of codes at a time: looks up both halves of the table and selects by
// the highest bit.
AVX512_VBMI void look_up_many(const std::uint8_t *table, const std::uint8_t *codes, int bytes,
                              std::uint8_t *out) {
    const __m512i first = _mm512_loadu_si512(table), second = _mm512_loadu_si512(table + 64),
                  third = _mm512_loadu_si512(table + 128), fourth = _mm512_loadu_si512(table + 192);
    for (int i = 0; i < bytes; i += 64) {
        const int left = bytes - i;
        const __mmask64 some = left < 64 ? (1ULL << left) - 1 : ~0ULL;
        const __m512i code = _mm512_maskz_loadu_epi8(some, codes + i);
        const __m512i lower = _mm512_permutex2var_epi8(first, code, second);
        const __m512i upper = _mm512_permutex2var_epi8(third, code, fourth);
        const __m512i found = _mm512_mask_blend_epi8(_mm512_movepi8_mask(code), lower, upper);
        _mm512_mask_storeu_epi8(out + i, some, found);
    }
}

#endif

void look_up(const std::uint8_t *table, const std::uint8_t *codes, int bytes, std::uint8_t *out) {
#if defined(WITH_VECTORS)
    static const bool at_once = __builtin_cpu_supports("avx512vbmi");
    if (at_once) {
        look_up_many(table, codes, bytes, out);
        return;
    }
#endif
    for (int i = 0; i < bytes; ++i) {
        out[i] = table[codes[i]];
    }
}

}  // namespace

void tint_rows(Picture picture, const Doubles &shares) {
    const Rows rows(picture);
    require(shares.ndim() == 2 && shares.shape(0) == rows.count && shares.shape(1) == kChannels,
            "shares are (rows, 3)");
    std::vector<std::uint8_t> share(rows.bytes());
    for (int v = 0; v < rows.count; ++v) {
        fill_row(codes_of(shares.data(v)), share);
        keep_shares(rows.at(v), share.data(), rows.bytes());
    }
}

void tint_masked(Picture picture, const Picture &mask, const std::array<float, 3> &depth) {
    const Rows rows(picture);
    require_mask(mask, rows);
    // One extra byte, because four are written at once.
    std::array<std::array<std::uint8_t, kChannels + 1>, 256> left{};
    for (int code = 0; code < 256; ++code) {
        for (int c = 0; c < kChannels; ++c) {
            left[code][c] = code_of(__builtin_fmaf(static_cast<float>(code), -depth[c], 255.0F));
        }
    }
    std::vector<std::uint8_t> share(rows.bytes() + 1);
    for (int v = 0; v < rows.count; ++v) {
        const std::uint8_t *code = mask.data(v);
        int first = 0, end = rows.width;
        while (first + kTogether <= end && eight_codes(code + first) == 0) {
            first += kTogether;
        }
        while (end - kTogether >= first && eight_codes(code + end - kTogether) == 0) {
            end -= kTogether;
        }
        int u = first;
        for (std::uint64_t before = 0; u + kTogether <= end; u += kTogether) {
            const std::uint64_t now = eight_codes(code + u);
            std::uint8_t *target = &share[kChannels * u];
            if (u > first && now == before) {  // most are in full light or in full shade
                std::memcpy(target, target - kChannels * kTogether, kChannels * kTogether);
                continue;
            }
            before = now;
            for (int i = 0; i < kTogether; ++i) {
                std::memcpy(target + kChannels * i, left[code[u + i]].data(), kChannels + 1);
            }
        }
        for (; u < end; ++u) {
            std::memcpy(&share[kChannels * u], left[code[u]].data(), kChannels + 1);
        }
        keep_shares(rows.at(v) + kChannels * first, share.data() + kChannels * first,
                    kChannels * (end - first));
    }
}

void average(const Bytes &canvas, Picture picture) {
    const bool mask = picture.ndim() == 2;
    require(canvas.ndim() == picture.ndim() && (mask || canvas.shape(2) == kChannels + 1) &&
                picture.size() > 0 && picture.strides(1) == (mask ? 1 : picture.shape(2)) &&
                (mask || picture.shape(2) == kChannels),
            "a mask and its canvas have one code a pixel, a picture three and its canvas four");
    const auto rows = static_cast<int>(picture.shape(0)), width = static_cast<int>(picture.shape(1));
    const auto finer = static_cast<int>(canvas.shape(0)) / rows;
    require(canvas.shape(0) == rows * finer && canvas.shape(1) == width * finer,
            "a canvas is as many times as high as its picture as it is wide");
    const auto average_one = mask ? averaging<std::uint16_t>(finer) : averaging<std::uint64_t>(finer);
    std::vector<std::uint16_t> sums(canvas.size() / canvas.shape(0));
    for (int v = 0; v < rows; ++v) {
        std::fill(sums.begin(), sums.end(), 0);
        for (int k = 0; k < finer; ++k) {
            add_row(canvas.data(v * finer + k), static_cast<int>(sums.size()), sums.data());
        }
        average_one(sums.data(), width, picture.mutable_data(v));
    }
}

void blend_masked(Picture picture, const Picture &mask, const std::array<float, 3> &paint,
                  double opacity) {
    const Rows rows(picture);
    require_mask(mask, rows);
    const auto share = static_cast<float>(opacity / 255);
    for (int v = 0; v < rows.count; ++v) {
        blend_row(rows.at(v), mask.data(v), share, paint.data(), rows.width);
    }
}

void develop(Picture ground, const Bytes &curve, const Doubles &kept, const Doubles &added,
             Picture picture) {
    const Rows from(ground), to(picture);
    require(from.count == to.count && from.width == to.width, "two pictures of one size");
    require(curve.size() == 256, "a curve has 256 codes");
    const int veiled = static_cast<int>(kept.size());
    require(veiled <= to.count && added.ndim() == 2 && added.shape(0) == veiled &&
                added.shape(1) == kChannels,
            "the upper rows keep a share (n,) and have something added (n, 3)");
    const std::uint8_t *table = curve.data();
    const int bytes = to.bytes();
    std::vector<std::uint8_t> share(bytes), more(bytes);
    for (int v = 0; v < to.count; ++v) {
        std::uint8_t *out = to.at(v);
        look_up(table, from.at(v), bytes, out);
        if (v < veiled) {
            std::fill(share.begin(), share.end(), exact_code_of(kept.data()[v]));
            fill_row(codes_of(added.data(v)), more);
            veil_row(out, share.data(), more.data(), bytes);
        }
    }
}

void lay_over(Picture picture, const Bytes &kept, const Bytes &added) {
    const Rows rows(picture);
    for (const Bytes *layer : {&kept, &added}) {
        require(layer->ndim() == 3 && layer->shape(0) == rows.count &&
                    layer->shape(1) == rows.width && layer->shape(2) == kChannels,
                "what is laid over a picture is as large as that");
    }
    for (int v = 0; v < rows.count; ++v) {
        veil_row(rows.at(v), kept.data(v), added.data(v), rows.bytes());
    }
}

void add_shine(Picture picture, const Floats &by_row, const Floats &by_column,
               const std::array<float, 3> &tint) {
    const Rows rows(picture);
    require(by_row.size() == rows.count && by_column.size() == rows.width,
            "one strength a row and one a column");
    std::vector<float> across(rows.bytes()), tints(rows.bytes());
    for (int i = 0; i < rows.bytes(); ++i) {
        across[i] = by_column.data()[i / kChannels];
        tints[i] = tint[i % kChannels];
    }
    for (int v = 0; v < rows.count; ++v) {
        shine_row(rows.at(v), by_row.data()[v], across.data(), tints.data(), rows.bytes());
    }
}

}  // namespace pixels
