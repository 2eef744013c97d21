#include "product.hpp"

#include "vectors.hpp"

namespace pixels {
namespace {

Colour colour_at(const Layer &layer, int u) {
    if (layer.texture == nullptr) {
        return layer.plain;
    }
    const Places &places = *layer.places;
    const std::uint8_t *upper = layer.texture->texels + places.offset[u];
    const std::uint8_t *lower = upper + layer.texture->stride();
    const int of_right = places.across[u] >> 8 & 0xFF, of_lower = places.down[u] >> 16;
    Colour colour;
    for (int c = 0; c < kChannels; ++c) {
        colour[c] = blended(upper, lower, c, c + kChannels, of_right, of_lower);
    }
    return colour;
}

void multiply(const Layer &ground, const Layer &grain, float scale, int first, int width,
              std::uint8_t *row) {
    for (int u = first; u < width; ++u) {
        const Colour colour = colour_at(ground, u), factor = colour_at(grain, u);
        for (int c = 0; c < kChannels; ++c) {
            row[kChannels * u + c] =
                code_of(static_cast<float>(colour[c]) * scale * static_cast<float>(factor[c]));
        }
    }
}

#if defined(WITH_VECTORS)

// Maximum of non-negative numbers.
FOR_EACH_PROCESSOR std::int32_t greatest(const std::int32_t *numbers, int count) {
    std::int32_t most = 0;
    for (int i = 0; i < count; ++i) {
        most = greater(most, numbers[i]);
    }
    return most;
}

// Whether eight bytes can be read at every position where six are needed.
bool is_roomy(const Layer &layer, int first, int width) {
    if (layer.texture == nullptr) {
        return true;
    }
    const std::int32_t furthest = greatest(layer.places->offset.data() + first, width - first);
    return furthest + layer.texture->stride() + 8 <= layer.texture->owner.size();
}

// A layer for vector code, to be passed by value: it stays in registers. Each pixel is red, green,
// blue and an unused value, in words of four bytes.
struct Source {
    const std::uint8_t *texels = nullptr;
    std::ptrdiff_t stride = 0;
    const std::int32_t *offset = nullptr, *across = nullptr, *down = nullptr;
    __m128i plain_pixel;

    explicit Source(const Layer &layer)
        : plain_pixel(_mm_setr_epi32(layer.plain[0], layer.plain[1], layer.plain[2], 0)) {
        if (layer.texture != nullptr) {
            texels = layer.texture->texels;
            stride = layer.texture->stride();
            offset = layer.places->offset.data();
            across = layer.places->across.data();
            down = layer.places->down.data();
        }
    }

    // Upper two texels in the lower half, lower two texels in the upper half; two bytes unused.
    AVX2 INLINE __m128i four_texels(int u) const {
        const std::uint8_t *upper = texels + offset[u];
        return _mm_unpacklo_epi64(_mm_loadu_si64(upper), _mm_loadu_si64(upper + stride));
    }

    // Shuffle that groups both upper and both lower texels by channel.
    AVX2 INLINE static __m128i by_channel() {
        return _mm_setr_epi8(0, 3, 8, 11, 1, 4, 9, 12, 2, 5, 10, 13, -1, -1, -1, -1);
    }
};

// Two pixels at a time.

AVX2 INLINE __m256i halves(const std::int32_t *words) {
    return _mm256_blend_epi32(_mm256_set1_epi32(words[0]), _mm256_set1_epi32(words[1]), 0xF0);
}

AVX2 INLINE __m256i two_pixels(Source source, int u) {
    if (source.texels == nullptr) {
        return _mm256_broadcastsi128_si256(source.plain_pixel);
    }
    const __m256i texels = _mm256_set_m128i(source.four_texels(u + 1), source.four_texels(u));
    const __m256i pairs =
        _mm256_shuffle_epi8(texels, _mm256_broadcastsi128_si256(Source::by_channel()));
    const __m256i blended = _mm256_maddubs_epi16(pairs, halves(source.across + u));
    const __m256i sum = _mm256_madd_epi16(blended, halves(source.down + u));
    return _mm256_srai_epi32(_mm256_add_epi32(sum, _mm256_set1_epi32(kWhole / 2)), 2 * kStepBits);
}

// Returns the first column that is not processed.
AVX2 int multiply_twos(Source ground, Source grain, float scale, int first, int width,
                       std::uint8_t *row) {
    const __m256 factor = _mm256_set1_ps(scale);
    const __m128i order =
        _mm_setr_epi8(0, 1, 2, 4, 5, 6, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
    int u = first;
    for (; u + 2 <= width; u += 2) {
        const __m256 scaled = _mm256_mul_ps(_mm256_cvtepi32_ps(two_pixels(ground, u)), factor);
        const __m256 product = _mm256_mul_ps(scaled, _mm256_cvtepi32_ps(two_pixels(grain, u)));
        const __m256i words = _mm256_cvtps_epi32(product);
        const __m128i both =
            _mm_packs_epi32(_mm256_castsi256_si128(words), _mm256_extracti128_si256(words, 1));
        const __m128i codes = _mm_shuffle_epi8(_mm_packus_epi16(both, both), order);
        _mm_storel_epi64(reinterpret_cast<__m128i *>(row + kChannels * u), codes);
    }
    return u;
}

// Four pixels at a time.

AVX512 INLINE __m512i quarters(const std::int32_t *words) {
    const __m512i index = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
    const __m128i four = _mm_loadu_si128(reinterpret_cast<const __m128i *>(words));
    return _mm512_permutexvar_epi32(index, _mm512_castsi128_si512(four));
}

AVX512 INLINE __m512i four_pixels(Source source, int u) {
    if (source.texels == nullptr) {
        return _mm512_broadcast_i32x4(source.plain_pixel);
    }
    const __m256i left = _mm256_set_m128i(source.four_texels(u + 1), source.four_texels(u));
    const __m256i right = _mm256_set_m128i(source.four_texels(u + 3), source.four_texels(u + 2));
    const __m512i texels = _mm512_inserti64x4(_mm512_castsi256_si512(left), right, 1);
    const __m512i pairs = _mm512_shuffle_epi8(texels, _mm512_broadcast_i32x4(Source::by_channel()));
    const __m512i blended = _mm512_maddubs_epi16(pairs, quarters(source.across + u));
    const __m512i sum = _mm512_madd_epi16(blended, quarters(source.down + u));
    return _mm512_srai_epi32(_mm512_add_epi32(sum, _mm512_set1_epi32(kWhole / 2)), 2 * kStepBits);
}

// Returns the first column that is not processed.
AVX512 int multiply_fours(Source ground, Source grain, float scale, int first, int width,
                          std::uint8_t *row) {
    const __m512 factor = _mm512_set1_ps(scale);
    const __m128i order =
        _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
    int u = first;
    for (; u + 4 <= width; u += 4) {
        const __m512 scaled = _mm512_mul_ps(_mm512_cvtepi32_ps(four_pixels(ground, u)), factor);
        const __m512 product = _mm512_mul_ps(scaled, _mm512_cvtepi32_ps(four_pixels(grain, u)));
        const __m128i codes = _mm512_cvtusepi32_epi8(_mm512_cvtps_epi32(product));
        _mm_storeu_si128(reinterpret_cast<__m128i *>(row + kChannels * u),
                         _mm_shuffle_epi8(codes, order));
    }
    return u;
}

#endif

}  // namespace

void multiply_row(const Layer &ground, const Layer &grain, float scale, int first, int width,
                  std::uint8_t *row) {
#if defined(WITH_VECTORS)
    static const bool by_two = __builtin_cpu_supports("avx2");
    static const bool by_four = __builtin_cpu_supports("avx512bw");
    if (by_two && is_roomy(ground, first, width) && is_roomy(grain, first, width)) {
        const Source of_ground(ground), of_grain(grain);
        if (by_four) {
            first = multiply_fours(of_ground, of_grain, scale, first, width, row);
        }
        first = multiply_twos(of_ground, of_grain, scale, first, width, row);
    }
#endif
    multiply(ground, grain, scale, first, width, row);
}

}  // namespace pixels
