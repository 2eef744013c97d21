#include "ground.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(PLAIN)
#define WITH_AVX2
#include <immintrin.h>
#endif

namespace pixels {
namespace {

#if defined(WITH_AVX2)
#define AVX2 __attribute__((target("avx2"), always_inline)) inline
#endif

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

// Where one pixel falls in a texture of this size; beyond its border the border goes on.
struct Place {
    std::int32_t offset, across, down;

    INLINE Place(int rows, int columns, float row, float column) {
        const std::int32_t y = within(rounded(row * kSteps), (rows - 1) * kSteps);
        const std::int32_t x = within(rounded(column * kSteps), (columns - 1) * kSteps);
        const std::int32_t top = lesser(y / kSteps, rows - 2);
        const std::int32_t left = lesser(x / kSteps, columns - 2);
        offset = (top * columns + left) * kChannels;
        across = weights(x - left * kSteps, 8) * 0x10001;
        down = weights(y - top * kSteps, 16);
    }

    // Of the first and the second of two texels, that many bits apart.
    INLINE static std::int32_t weights(std::int32_t second, int bits) {
        return (second << bits) + kSteps - second;
    }
};

using Colour = std::array<std::int32_t, kChannels>;

INLINE Colour colour_at(const Texture &texture, const Places &places, int u) {
    const std::uint8_t *upper = texture.texels + places.offset[u];
    const std::uint8_t *lower = upper + texture.stride();
    const int left = places.across[u] & 0xFF, right = places.across[u] >> 8 & 0xFF;
    const int above = places.down[u] & 0xFFFF, below = places.down[u] >> 16;
    Colour colour;
    for (int c = 0; c < kChannels; ++c) {
        const int high = upper[c] * left + upper[c + kChannels] * right;
        const int low = lower[c] * left + lower[c + kChannels] * right;
        colour[c] = (high * above + low * below + kWhole / 2) / kWhole;
    }
    return colour;
}

// The largest of some numbers, none of them negative.
FOR_EACH_PROCESSOR std::int32_t greatest(const std::int32_t *numbers, int count) {
    std::int32_t most = 0;
    for (int i = 0; i < count; ++i) {
        most = greater(most, numbers[i]);
    }
    return most;
}

// What is looked up for one row: a texture, and where in it. Without a texture it is one colour.
struct Layer {
    const Texture *texture;
    const Places *places;
    Colour plain;

    INLINE Colour at(int u) const {
        return texture == nullptr ? plain : colour_at(*texture, *places, u);
    }

    // Whether eight bytes can be read wherever six are needed, from one column on.
    bool roomy(int first, int width) const {
        if (texture == nullptr) {
            return true;
        }
        const std::int32_t furthest = greatest(places->offset.data() + first, width - first);
        return furthest + texture->stride() + 8 <= texture->owner.size();
    }
};

// The product of ground and grain, from one column on.
void multiply(const Layer &ground, const Layer &grain, float scale, int first, int width,
              std::uint8_t *row) {
    for (int u = first; u < width; ++u) {
        const Colour colour = ground.at(u), factor = grain.at(u);
        for (int c = 0; c < kChannels; ++c) {
            row[kChannels * u + c] =
                code_of(static_cast<float>(colour[c]) * scale * static_cast<float>(factor[c]));
        }
    }
}

#if defined(WITH_AVX2)

// The same for two pixels at a time: red, green, blue and nothing of each in a half of a register.
class TwoPixels {
  public:
    AVX2 explicit TwoPixels(const Layer &layer)
        : plain_(_mm256_setr_epi32(layer.plain[0], layer.plain[1], layer.plain[2], 0,
                                   layer.plain[0], layer.plain[1], layer.plain[2], 0)),
          texels_(nullptr) {
        if (layer.texture != nullptr) {
            texels_ = layer.texture->texels;
            stride_ = layer.texture->stride();
            offset_ = layer.places->offset.data();
            across_ = layer.places->across.data();
            down_ = layer.places->down.data();
        }
    }

    AVX2 __m256i at(int u) const {
        if (texels_ == nullptr) {
            return plain_;
        }
        // Of each channel both upper and both lower texels side by side.
        const __m256i order = _mm256_broadcastsi128_si256(
            _mm_setr_epi8(0, 3, 8, 11, 1, 4, 9, 12, 2, 5, 10, 13, -1, -1, -1, -1));
        const __m256i texels = _mm256_set_m128i(four_texels(u + 1), four_texels(u));
        const __m256i pairs = _mm256_shuffle_epi8(texels, order);
        const __m256i blended = _mm256_maddubs_epi16(pairs, halves(across_ + u));
        const __m256i sum = _mm256_madd_epi16(blended, halves(down_ + u));
        const __m256i half = _mm256_set1_epi32(kWhole / 2);
        return _mm256_srai_epi32(_mm256_add_epi32(sum, half), 2 * kStepBits);
    }

  private:
    AVX2 __m128i four_texels(int u) const {
        const std::uint8_t *upper = texels_ + offset_[u];
        return _mm_unpacklo_epi64(_mm_loadu_si64(upper), _mm_loadu_si64(upper + stride_));
    }

    AVX2 static __m256i halves(const std::int32_t *words) {
        return _mm256_blend_epi32(_mm256_set1_epi32(words[0]), _mm256_set1_epi32(words[1]), 0xF0);
    }

    __m256i plain_;
    const std::uint8_t *texels_;
    std::ptrdiff_t stride_ = 0;
    const std::int32_t *offset_ = nullptr, *across_ = nullptr, *down_ = nullptr;
};

// Returns the first column that is left. Two bytes beyond what it fills are written to.
__attribute__((target("avx2"))) int multiply_pairs(const Layer &ground_layer,
                                                   const Layer &grain_layer, float scale,
                                                   int first, int width, std::uint8_t *row) {
    const TwoPixels ground(ground_layer), grain(grain_layer);
    const __m256 factor = _mm256_set1_ps(scale);
    const __m128i order =
        _mm_setr_epi8(0, 1, 2, 4, 5, 6, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
    int u = first;
    for (; u + 2 <= width; u += 2) {
        const __m256 scaled = _mm256_mul_ps(_mm256_cvtepi32_ps(ground.at(u)), factor);
        const __m256 product = _mm256_mul_ps(scaled, _mm256_cvtepi32_ps(grain.at(u)));
        const __m256i words = _mm256_cvtps_epi32(product);
        const __m128i both =
            _mm_packs_epi32(_mm256_castsi256_si128(words), _mm256_extracti128_si256(words, 1));
        const __m128i codes = _mm_shuffle_epi8(_mm_packus_epi16(both, both), order);
        _mm_storel_epi64(reinterpret_cast<__m128i *>(row + kChannels * u), codes);
    }
    return u;
}

#endif

// One pose's view of the ground and of its grain.
struct View {
    Parts fall, density_along, density_across;
    Linear along, across, grain_along, grain_across;
};

FOR_EACH_PROCESSOR void find_places(const View &view, const Ruler &measured, int v, int first,
                                    int width, const float *__restrict dither, bool grained,
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
    std::int32_t *__restrict ground_across = ground.across.data();
    std::int32_t *__restrict ground_down = ground.down.data();
    std::int32_t *__restrict grain_offset = grain.offset.data();
    std::int32_t *__restrict grain_across = grain.across.data();
    std::int32_t *__restrict grain_down = grain.down.data();
    const float fall_of_row = view.fall.by_row[v];
    const float along_of_row = view.density_along.by_row[v];
    const float across_of_row = view.density_across.by_row[v];
    const int atlas_rows = atlas.rows, atlas_columns = atlas.columns;
    const int tile_rows = tile.rows, tile_columns = tile.columns;
    INDEPENDENT
    for (int u = first; u < width; ++u) {
        // The sky gets the last ground.
        float fall = fall_by_column[u] + fall_of_row;
        fall = fall < ruler.least_fall ? ruler.least_fall : fall;
        const float w = 1.0F / fall, uw = w * static_cast<float>(u);
        const float common = fall * fall * dither[u];
        // The scales of the levels: that of level i is 2^-i. Of the footprint's sides the larger
        // one counts, which has fewer pixels per texel.
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
        ground_across[u] = on_ground.across;
        ground_down[u] = on_ground.down;
        if (grained) {
            const Place in_grain(
                tile_rows, tile_columns,
                ruler.grain_along.on_level(grain_along_form.at(uw, w), along),
                ruler.grain_across.on_level(grain_across_form.at(uw, w), across));
            grain_offset[u] = in_grain.offset;
            grain_across[u] = in_grain.across;
            grain_down[u] = in_grain.down;
        }
    }
}

void read_row(const Layer &ground, const Layer &grain, float scale, int first, int width,
              std::uint8_t *row) {
#if defined(WITH_AVX2)
    static const bool with_avx2 = __builtin_cpu_supports("avx2");
    if (with_avx2 && ground.roomy(first, width) && grain.roomy(first, width)) {
        first = multiply_pairs(ground, grain, scale, first, width, row);
    }
#endif
    multiply(ground, grain, scale, first, width, row);
}

void ask_for(const Texture &texture, const Places &places, int first) {
    for (auto offset = places.offset.begin() + first; offset < places.offset.end(); ++offset) {
        __builtin_prefetch(texture.texels + *offset);
        __builtin_prefetch(texture.texels + *offset + texture.stride());
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
      row_(static_cast<std::size_t>(width_) * kChannels + 2) {}

void Ground::sample(Bytes out, const Sight &sight, const Whole &hidden) {
    require(out.ndim() == 3 && out.shape(0) == height_ && out.shape(1) == width_ &&
                out.shape(2) == kChannels && sight.height() == height_ && sight.width() == width_,
            "picture, sight and dither are of one size");
    require(hidden.size() == height_ && std::all_of(hidden.data(), hidden.data() + height_,
                                                    [this](std::int32_t columns) {
                                                        return 0 <= columns && columns <= width_;
                                                    }),
            "so many columns are hidden in each row, no more than it has");
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
    // The grain of a row is asked for while the row before is read: it is spread over more memory
    // than a core's cache has, and the ground under a row is not.
    for (int v = 0; v <= height_; ++v) {
        if (v < height_) {
            Places &ground = ground_places_[v % 2], &grain = grain_places_[v % 2];
            const bool grained = v >= first_grain_row;
            const int first = hidden.data()[v];
            find_places(view, ruler_, v, first, width_,
                        dither + static_cast<std::size_t>(v) * width_, grained, atlas_, grain_,
                        ground, grain);
            if (grained) {
                ask_for(grain_, grain, first);
            }
        }
        if (v > 0) {
            const Layer ground{&atlas_, &ground_places_[(v - 1) % 2], {}};
            const Layer grain{v > first_grain_row ? &grain_ : nullptr, &grain_places_[(v - 1) % 2],
                              neutral_};
            const int first = hidden.data()[v - 1], skipped = first * kChannels;
            read_row(ground, grain, scale_, first, width_, row_.data());
            std::memcpy(target + (v - 1) * stride + skipped, row_.data() + skipped,
                        stride - skipped);
        }
    }
}

}  // namespace pixels
