#include "ground.hpp"

#include <cstring>
#include <utility>

#if defined(__SSE2__) && !defined(PLAIN)
#include <emmintrin.h>
#endif

namespace pixels {
namespace {

// A position between texels in steps of 1/32, as OpenCV's bilinear interpolation has it.
constexpr int kSteps = 32;

// Largest power of two not above a normal, positive number.
INLINE float whole_power_of_two(float number) {
    return std::bit_cast<float>(std::bit_cast<std::int32_t>(number) & 0x7F800000);
}

struct Linear {
    float by_uw, by_w, constant;

    explicit Linear(const Form &form)
        : by_uw(static_cast<float>(form[0])),
          by_w(static_cast<float>(form[1])),
          constant(static_cast<float>(form[2])) {}

    INLINE float at(float uw, float w) const {
        return __builtin_fmaf(uw, by_uw, __builtin_fmaf(w, by_w, constant));
    }
};

// One of them, in a texture of this size; beyond its border the border goes on. Two weights share a
// word, the left one in its lower half.
struct Place {
    std::int32_t offset, upper, lower;

    INLINE Place(int rows, int columns, float row, float column) {
        const std::int32_t y = within(rounded(row * kSteps), (rows - 1) * kSteps);
        const std::int32_t x = within(rounded(column * kSteps), (columns - 1) * kSteps);
        const std::int32_t top = lesser(y >> 5, rows - 2);
        const std::int32_t left = lesser(x >> 5, columns - 2);
        offset = (top * columns + left) * kChannels;
        const std::int32_t right = x - left * kSteps;
        const std::int32_t both = (right << 16) + kSteps - right;
        lower = (y - top * kSteps) * both;
        upper = (both << 5) - lower;
    }
};

#if defined(__SSE2__) && !defined(PLAIN)

using Colour = __m128i;

INLINE __m128i four_bytes(const std::uint8_t *first) {
    std::int32_t bits;
    std::memcpy(&bits, first, sizeof bits);
    return _mm_cvtsi32_si128(bits);
}

// Two neighbours' weighted sum; of the second, read without going beyond the texture's last byte,
// the first byte is its neighbour's.
INLINE __m128i blended(const std::uint8_t *texels, std::int32_t weights) {
    const __m128i second = _mm_srli_epi32(four_bytes(texels + kChannels - 1), 8);
    const __m128i pairs = _mm_unpacklo_epi8(four_bytes(texels), second);
    return _mm_madd_epi16(_mm_unpacklo_epi8(pairs, _mm_setzero_si128()), _mm_set1_epi32(weights));
}

INLINE Colour colour_at(const std::uint8_t *upper, std::ptrdiff_t row, std::int32_t upper_weights,
                        std::int32_t lower_weights) {
    const __m128i sum =
        _mm_add_epi32(blended(upper, upper_weights), blended(upper + row, lower_weights));
    return _mm_srai_epi32(_mm_add_epi32(sum, _mm_set1_epi32(512)), 10);
}

INLINE Colour colour_of(const std::array<int, 3> &codes) {
    return _mm_setr_epi32(codes[0], codes[1], codes[2], 0);
}

// Writes four bytes, of which the last is to be written over.
INLINE void write_product(Colour colour, float scale, Colour factor, std::uint8_t *out) {
    const __m128 scaled = _mm_mul_ps(_mm_cvtepi32_ps(colour), _mm_set1_ps(scale));
    const __m128i codes = _mm_cvtps_epi32(_mm_mul_ps(scaled, _mm_cvtepi32_ps(factor)));
    const __m128i words = _mm_packs_epi32(codes, codes);
    const std::int32_t bits = _mm_cvtsi128_si32(_mm_packus_epi16(words, words));
    std::memcpy(out, &bits, sizeof bits);
}

#else

using Colour = std::array<std::int32_t, kChannels>;

INLINE Colour colour_at(const std::uint8_t *upper, std::ptrdiff_t row, std::int32_t upper_weights,
                        std::int32_t lower_weights) {
    const std::uint8_t *lower = upper + row;
    Colour colour;
    for (int c = 0; c < kChannels; ++c) {
        colour[c] = (upper[c] * (upper_weights & 0xFFFF) +
                     upper[c + kChannels] * (upper_weights >> 16) +
                     lower[c] * (lower_weights & 0xFFFF) +
                     lower[c + kChannels] * (lower_weights >> 16) + 512) >> 10;
    }
    return colour;
}

INLINE Colour colour_of(const std::array<int, 3> &codes) { return {codes[0], codes[1], codes[2]}; }

INLINE void write_product(Colour colour, float scale, Colour factor, std::uint8_t *out) {
    for (int c = 0; c < kChannels; ++c) {
        const float product = static_cast<float>(colour[c]) * scale * static_cast<float>(factor[c]);
        out[c] = static_cast<std::uint8_t>(within(rounded(product), 255));
    }
}

#endif

// One pose's view of the ground and of its grain.
struct View {
    Parts fall, density_along, density_across;
    Linear along, across, grain_along, grain_across;
};

FOR_EACH_PROCESSOR void find_places(const View &view, const Ruler &measured, int v, int width,
                                    const float *__restrict dither, bool grained,
                                    const Texture &atlas, const Texture &tile, Places &ground,
                                    Places &grain) {
    const Linear along_form = view.along, across_form = view.across;
    const Linear grain_along_form = view.grain_along, grain_across_form = view.grain_across;
    const Ruler ruler = measured;
    const std::int32_t level_bits = ruler.bend.levels << 23;
    const float *__restrict fall_by_column = view.fall.by_column.data();
    const float *__restrict along_by_column = view.density_along.by_column.data();
    const float *__restrict across_by_column = view.density_across.by_column.data();
    std::int32_t *__restrict ground_offset = ground.offset.data();
    std::int32_t *__restrict ground_upper = ground.upper.data();
    std::int32_t *__restrict ground_lower = ground.lower.data();
    std::int32_t *__restrict grain_offset = grain.offset.data();
    std::int32_t *__restrict grain_upper = grain.upper.data();
    std::int32_t *__restrict grain_lower = grain.lower.data();
    const float fall_of_row = view.fall.by_row[v];
    const float along_of_row = view.density_along.by_row[v];
    const float across_of_row = view.density_across.by_row[v];
    const int atlas_rows = atlas.rows, atlas_columns = atlas.columns;
    const int tile_rows = tile.rows, tile_columns = tile.columns;
#pragma GCC ivdep
    for (int u = 0; u < width; ++u) {
        // The sky gets the last ground.
        float fall = fall_by_column[u] + fall_of_row;
        fall = fall < ruler.least_fall ? ruler.least_fall : fall;
        const float w = 1.0F / fall, uw = w * static_cast<float>(u);
        const float common = fall * fall * dither[u];
        const float along_density =
            along_by_column[u] < along_of_row ? along_by_column[u] : along_of_row;
        const float across_density =
            across_by_column[u] < across_of_row ? across_by_column[u] : across_of_row;
        const float along = whole_power_of_two(along_density * common);
        const float across = whole_power_of_two(across_density * common);

        const float coarse = across_form.at(uw, w);
        const float inside = clipped(coarse, ruler.bend.least, ruler.bend.most);
        const bool beyond = __builtin_fabsf(coarse - inside) > ruler.bend.threshold;
        const float level = std::bit_cast<float>(std::bit_cast<std::int32_t>(across) +
                                                 (beyond ? level_bits : 0));
        const Place on_ground(
            atlas_rows, atlas_columns, ruler.along.on_level(along_form.at(uw, w), along),
            ruler.across.on_level(__builtin_fmaf(inside, ruler.bend.factor, coarse), level));
        ground_offset[u] = on_ground.offset;
        ground_upper[u] = on_ground.upper;
        ground_lower[u] = on_ground.lower;
        if (grained) {
            const Place in_grain(
                tile_rows, tile_columns,
                ruler.grain_along.on_level(grain_along_form.at(uw, w), along),
                ruler.grain_across.on_level(grain_across_form.at(uw, w), across));
            grain_offset[u] = in_grain.offset;
            grain_upper[u] = in_grain.upper;
            grain_lower[u] = in_grain.lower;
        }
    }
}

FOR_EACH_PROCESSOR void read_row(const Texture &atlas, const Places &ground, bool grained, const Texture &tile,
              const Places &grain, Colour neutral, float scale, int width,
              std::uint8_t *__restrict out) {
    const std::uint8_t *atlas_texels = atlas.texels, *tile_texels = tile.texels;
    const std::ptrdiff_t atlas_row = static_cast<std::ptrdiff_t>(atlas.columns) * kChannels;
    const std::ptrdiff_t tile_row = static_cast<std::ptrdiff_t>(tile.columns) * kChannels;
    const std::int32_t *ground_offset = ground.offset.data(), *ground_upper = ground.upper.data(),
                       *ground_lower = ground.lower.data();
    const std::int32_t *grain_offset = grain.offset.data(), *grain_upper = grain.upper.data(),
                       *grain_lower = grain.lower.data();
    for (int u = 0; u < width; ++u) {
        const Colour colour = colour_at(atlas_texels + ground_offset[u], atlas_row, ground_upper[u],
                                        ground_lower[u]);
        const Colour factor = grained ? colour_at(tile_texels + grain_offset[u], tile_row,
                                                  grain_upper[u], grain_lower[u])
                                      : neutral;
        write_product(colour, scale, factor, out + kChannels * u);
    }
}

void ask_for(const Texture &texture, const Places &places) {
    const std::ptrdiff_t row = static_cast<std::ptrdiff_t>(texture.columns) * kChannels;
    for (const std::int32_t offset : places.offset) {
        __builtin_prefetch(texture.texels + offset);
        __builtin_prefetch(texture.texels + offset + row);
    }
}

}  // namespace

Ground::Ground(Bytes atlas, Bytes grain, Floats dither, const Ruler &ruler,
       const std::array<int, 3> &neutral, float scale)
    : atlas_(std::move(atlas)),
      grain_(std::move(grain)),
      dither_(std::move(dither)),
      ruler_(ruler),
      neutral_(neutral),
      scale_(scale),
      height_(static_cast<int>(dither_.shape(0))),
      width_(static_cast<int>(dither_.shape(1))),
      ground_places_{Places(width_), Places(width_)},
      grain_places_{Places(width_), Places(width_)},
      row_(static_cast<std::size_t>(width_) * kChannels + 1) {}

void Ground::sample(Bytes out, const Sight &sight) {
    require(out.ndim() == 3 && out.shape(0) == height_ && out.shape(1) == width_ &&
                out.shape(2) == kChannels && sight.height() == height_ && sight.width() == width_,
            "picture, sight and dither are of one size");
    const View view{sight.fall(),
                    sight.density(0, ruler_.along.texel_m),
                    sight.density(1, ruler_.across.texel_m),
                    Linear(sight.coordinate(0, ruler_.along.unit_m, ruler_.along.origin)),
                    Linear(sight.coordinate(1, ruler_.across.unit_m, ruler_.across.origin)),
                    Linear(sight.coordinate_in_tile(0, ruler_.tile_m)),
                    Linear(sight.coordinate_in_tile(1, ruler_.tile_m))};
    const int first_grain_row = sight.first_row_nearer_than(ruler_.grain_reach_m);
    const std::size_t stride = static_cast<std::size_t>(width_) * kChannels;
    std::uint8_t *target = out.mutable_data();
    const float *dither = dither_.data();
    const Colour neutral = colour_of(neutral_);
    // The texels of a row are asked for while those of the row before are read.
    for (int v = 0; v <= height_; ++v) {
        if (v < height_) {
            find_places(view, ruler_, v, width_, dither + static_cast<std::size_t>(v) * width_,
                        v >= first_grain_row, atlas_, grain_, ground_places_[v % 2],
                        grain_places_[v % 2]);
            ask_for(atlas_, ground_places_[v % 2]);
            if (v >= first_grain_row) {
                ask_for(grain_, grain_places_[v % 2]);
            }
        }
        if (v > 0) {
            read_row(atlas_, ground_places_[(v - 1) % 2], v > first_grain_row, grain_,
                     grain_places_[(v - 1) % 2], neutral, scale_, width_, row_.data());
            std::memcpy(target + (v - 1) * stride, row_.data(), stride);
        }
    }
}

}  // namespace pixels
