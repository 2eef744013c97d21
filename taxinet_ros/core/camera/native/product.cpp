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
    const int of_right = places.weights[u] >> 8 & 0xFF, of_lower = places.weights[u] >> 24;
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

// Whether eight bytes can be read at every position where six are needed.
bool is_roomy(const Layer &layer) {
    return layer.texture == nullptr || layer.places->furthest + layer.texture->stride() + 8 <=
                                           layer.texture->owner.size();
}

// A layer for vector code, to be passed by value: it stays in registers. Each pixel is red, green,
// blue and an unused value, in words of four bytes.
struct Source {
    const std::uint8_t *upper = nullptr, *lower = nullptr;
    const std::int32_t *offset = nullptr, *weights = nullptr;
    __m128i plain_pixel;

    explicit Source(const Layer &layer)
        : plain_pixel(_mm_setr_epi32(layer.plain[0], layer.plain[1], layer.plain[2], 0)) {
        if (layer.texture != nullptr) {
            upper = layer.texture->texels;
            lower = upper + layer.texture->stride();
            offset = layer.places->offset.data();
            weights = layer.places->weights.data();
        }
    }

    // Upper two texels in the lower half, lower two texels in the upper half; two bytes unused.
    AVX2 INLINE __m128i four_texels(std::ptrdiff_t u) const {
        const std::ptrdiff_t place = offset[u];
        const __m128 above = _mm_castsi128_ps(_mm_loadu_si64(upper + place));
        return _mm_castps_si128(
            _mm_loadh_pi(above, reinterpret_cast<const __m64 *>(lower + place)));
    }

    // Shuffle that groups both upper and both lower texels by channel.
    AVX2 INLINE static __m128i by_channel() {
        return _mm_setr_epi8(0, 3, 8, 11, 1, 4, 9, 12, 2, 5, 10, 13, -1, -1, -1, -1);
    }
};

// Shuffles of a pixel's four weights: left and right, a byte each; above and below, a word each, of
// which the upper byte is none's; and how much further those of the next pixel are.
constexpr std::int16_t kAcross = 0x0100;
constexpr std::int32_t kDown = static_cast<std::int32_t>(0x80038002);
constexpr std::int64_t kNext = 0x0404040404040404;

// Two pixels at a time.

AVX2 INLINE __m256i two_pixels(Source source, std::ptrdiff_t u) {
    if (source.upper == nullptr) {
        return _mm256_broadcastsi128_si256(source.plain_pixel);
    }
    const __m256i texels = _mm256_set_m128i(source.four_texels(u + 1), source.four_texels(u));
    const __m256i pairs =
        _mm256_shuffle_epi8(texels, _mm256_broadcastsi128_si256(Source::by_channel()));
    const __m256i weights = _mm256_broadcastq_epi64(_mm_loadu_si64(source.weights + u));
    const __m256i pixel = _mm256_setr_epi64x(0, 0, kNext, kNext);
    const __m256i across = _mm256_add_epi8(_mm256_set1_epi16(kAcross), pixel);
    const __m256i down = _mm256_add_epi8(_mm256_set1_epi32(kDown), pixel);
    const __m256i blended = _mm256_maddubs_epi16(pairs, _mm256_shuffle_epi8(weights, across));
    const __m256i sum = _mm256_madd_epi16(blended, _mm256_shuffle_epi8(weights, down));
    return _mm256_srai_epi32(_mm256_add_epi32(sum, _mm256_set1_epi32(kWhole / 2)), 2 * kStepBits);
}

// Returns the first column that is not processed.
AVX2 int multiply_twos(Source ground, Source grain, float scale, int first, int width,
                       std::uint8_t *row) {
    const __m256 factor = _mm256_set1_ps(scale);
    const __m128i order =
        _mm_setr_epi8(0, 1, 2, 4, 5, 6, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
    std::ptrdiff_t u = first;
    for (; u + 2 <= width; u += 2) {
        const __m256 scaled = _mm256_mul_ps(_mm256_cvtepi32_ps(two_pixels(ground, u)), factor);
        const __m256 product = _mm256_mul_ps(scaled, _mm256_cvtepi32_ps(two_pixels(grain, u)));
        const __m256i words = _mm256_cvtps_epi32(product);
        const __m128i both =
            _mm_packs_epi32(_mm256_castsi256_si128(words), _mm256_extracti128_si256(words, 1));
        const __m128i codes = _mm_shuffle_epi8(_mm_packus_epi16(both, both), order);
        _mm_storel_epi64(reinterpret_cast<__m128i *>(row + kChannels * u), codes);
    }
    return static_cast<int>(u);
}

// Four pixels at a time.

AVX512 INLINE __m512i four_pixels(Source source, std::ptrdiff_t u) {
    if (source.upper == nullptr) {
        return _mm512_broadcast_i32x4(source.plain_pixel);
    }
    const __m256i left = _mm256_set_m128i(source.four_texels(u + 1), source.four_texels(u));
    const __m256i right = _mm256_set_m128i(source.four_texels(u + 3), source.four_texels(u + 2));
    const __m512i texels = _mm512_inserti64x4(_mm512_castsi256_si512(left), right, 1);
    const __m512i pairs = _mm512_shuffle_epi8(texels, _mm512_broadcast_i32x4(Source::by_channel()));
    const __m512i weights = _mm512_broadcast_i32x4(
        _mm_loadu_si128(reinterpret_cast<const __m128i *>(source.weights + u)));
    const __m512i pixel =
        _mm512_setr_epi64(0, 0, kNext, kNext, 2 * kNext, 2 * kNext, 3 * kNext, 3 * kNext);
    const __m512i across = _mm512_add_epi8(_mm512_set1_epi16(kAcross), pixel);
    const __m512i down = _mm512_add_epi8(_mm512_set1_epi32(kDown), pixel);
    const __m512i blended = _mm512_maddubs_epi16(pairs, _mm512_shuffle_epi8(weights, across));
    const __m512i sum = _mm512_madd_epi16(blended, _mm512_shuffle_epi8(weights, down));
    return _mm512_srai_epi32(_mm512_add_epi32(sum, _mm512_set1_epi32(kWhole / 2)), 2 * kStepBits);
}

// Returns the first column that is not processed.
AVX512 int multiply_fours(Source ground, Source grain, float scale, int first, int width,
                          std::uint8_t *row) {
    const __m512 factor = _mm512_set1_ps(scale);
    const __m128i order =
        _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
    std::ptrdiff_t u = first;
    for (; u + 4 <= width; u += 4) {
        const __m512 scaled = _mm512_mul_ps(_mm512_cvtepi32_ps(four_pixels(ground, u)), factor);
        const __m512 product = _mm512_mul_ps(scaled, _mm512_cvtepi32_ps(four_pixels(grain, u)));
        const __m128i codes = _mm512_cvtusepi32_epi8(_mm512_cvtps_epi32(product));
        _mm_storeu_si128(reinterpret_cast<__m128i *>(row + kChannels * u),
                         _mm_shuffle_epi8(codes, order));
    }
    return static_cast<int>(u);
}

#endif

}  // namespace

void multiply_row(const Layer &ground, const Layer &grain, float scale, int first, int width,
                  std::uint8_t *row) {
#if defined(WITH_VECTORS)
    static const bool by_two = __builtin_cpu_supports("avx2");
    static const bool by_four = __builtin_cpu_supports("avx512bw");
    if (by_two && is_roomy(ground) && is_roomy(grain)) {
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
