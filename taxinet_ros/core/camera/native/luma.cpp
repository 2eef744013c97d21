#include "luma.hpp"

#include "vectors.hpp"

namespace pixels {
namespace {

constexpr int kRed = 9798, kGreen = 19235, kBlue = 3735, kBits = 15, kHalf = 1 << (kBits - 1);

#if defined(WITH_VECTORS)

// Of eight pixels, in words of four bytes; four bytes beyond them are read.
AVX2 INLINE __m256i eight_lumas(const std::uint8_t *colours) {
    const auto *from = reinterpret_cast<const __m128i *>(colours);
    const auto *next = reinterpret_cast<const __m128i *>(colours + 4 * kChannels);
    const __m256i codes = _mm256_set_m128i(_mm_loadu_si128(next), _mm_loadu_si128(from));
    const __m256i red_green = _mm256_shuffle_epi8(
        codes, _mm256_broadcastsi128_si256(_mm_setr_epi8(0, -1, 1, -1, 3, -1, 4, -1, 6, -1, 7, -1,
                                                         9, -1, 10, -1)));
    const __m256i blue = _mm256_shuffle_epi8(
        codes, _mm256_broadcastsi128_si256(_mm_setr_epi8(2, -1, -1, -1, 5, -1, -1, -1, 8, -1, -1,
                                                         -1, 11, -1, -1, -1)));
    const __m256i sum = _mm256_add_epi32(
        _mm256_madd_epi16(red_green, _mm256_set1_epi32(kGreen << 16 | kRed)),
        _mm256_madd_epi16(blue, _mm256_set1_epi32(kBlue)));
    return _mm256_srai_epi32(_mm256_add_epi32(sum, _mm256_set1_epi32(kHalf)), kBits);
}

// Returns the number of pixels that are processed.
AVX2 int grey_sixteens(const std::uint8_t *colours, int count, std::uint8_t *grey) {
    constexpr int kInOrder = 0b11011000, kFirstAndThird = 0b1000;
    int u = 0;
    for (; u + 16 < count - 1; u += 16) {
        const __m256i words = _mm256_permute4x64_epi64(
            _mm256_packs_epi32(eight_lumas(colours + kChannels * u),
                               eight_lumas(colours + kChannels * (u + 8))),
            kInOrder);
        const __m256i codes =
            _mm256_permute4x64_epi64(_mm256_packus_epi16(words, words), kFirstAndThird);
        _mm_storeu_si128(reinterpret_cast<__m128i *>(grey + u), _mm256_castsi256_si128(codes));
    }
    return u;
}

#endif

}  // namespace

void grey_codes(const std::uint8_t *colours, int count, std::uint8_t *grey) {
    int u = 0;
#if defined(WITH_VECTORS)
    static const bool by_sixteen = __builtin_cpu_supports("avx2");
    if (by_sixteen) {
        u = grey_sixteens(colours, count, grey);
    }
#endif
    for (; u < count; ++u) {
        const std::uint8_t *colour = colours + kChannels * u;
        const int sum = kRed * colour[0] + kGreen * colour[1] + kBlue * colour[2];
        grey[u] = static_cast<std::uint8_t>((sum + kHalf) >> kBits);
    }
}

}  // namespace pixels
