#include "ground.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "product.hpp"

namespace pixels {
namespace {

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

// Position of one pixel in a texture of this size, clamped to its border.
struct Place {
    std::int32_t offset, weights;

    // Row and column are in steps.
    INLINE Place(int rows, int columns, float row, float column) {
        const std::int32_t y = within(rounded(row), (rows - 1) * kSteps - 1);
        const std::int32_t x = within(rounded(column), (columns - 1) * kSteps - 1);
        offset = ((y >> kStepBits) * columns + (x >> kStepBits)) * kChannels;
        weights = weights_of(x & (kSteps - 1), y & (kSteps - 1));
    }
};

// View of the ground and its grain from one pose.
struct View {
    Parts fall, density_along, density_across;
    Linear along, across, grain_along, grain_across;
};

// Pixels whose places are found together: whole vectors on every processor.
constexpr int kBlock = 16;

int whole_blocks(int pixels) { return (pixels + kBlock - 1) / kBlock * kBlock; }

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
    std::int32_t *__restrict ground_weights = ground.weights.data();
    std::int32_t *__restrict grain_offset = grain.offset.data();
    std::int32_t *__restrict grain_weights = grain.weights.data();
    const float fall_of_row = view.fall.by_row[v];
    const float along_of_row = view.density_along.by_row[v];
    const float across_of_row = view.density_across.by_row[v];
    const int atlas_rows = atlas.rows, atlas_columns = atlas.columns;
    const int tile_rows = tile.rows, tile_columns = tile.columns;
    INDEPENDENT
    for (int u = first; u < width; ++u) {
        // Pixels of the sky use the farthest ground.
        float fall = fall_by_column[u] + fall_of_row;
        fall = fall < ruler.least_fall ? ruler.least_fall : fall;
        const float w = 1.0F / fall, uw = w * static_cast<float>(u);
        const float common = fall * fall * dither[u];
        // Level i has the scale 2^-i, here times kSteps. The larger side of the footprint, which has
        // fewer pixels per texel, determines the level.
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
        ground_weights[u] = on_ground.weights;
        if (grained) {
            const Place in_grain(
                tile_rows, tile_columns,
                ruler.grain_along.on_level(grain_along_form.at(uw, w), along),
                ruler.grain_across.on_level(grain_across_form.at(uw, w), across));
            grain_offset[u] = in_grain.offset;
            grain_weights[u] = in_grain.weights;
        }
    }
    ground.furthest = furthest_of(ground_offset + first, width - first);
    grain.furthest = grained ? furthest_of(grain_offset + first, width - first) : 0;
}

// Neighbours share lines of the cache, but not those of other levels: every third pixel has another
// dither, so that all levels are among them.
void ask_for(const Texture &texture, const Places &places, int first, int width) {
    constexpr int kApart = 3;
    const std::int32_t *offset = places.offset.data();
    const std::ptrdiff_t stride = texture.stride();
    for (int u = first; u < width; u += kApart) {
        const std::uint8_t *upper = texture.texels + offset[u];
        __builtin_prefetch(upper);
        __builtin_prefetch(upper + stride);
    }
}

}  // namespace

Ground::Ground(Bytes atlas, Bytes grain, const Floats &dither, const Ruler &ruler,
               const std::array<int, 3> &neutral, float scale)
    : atlas_(std::move(atlas)),
      grain_(std::move(grain)),
      ruler_(ruler.in_steps()),
      neutral_(neutral),
      scale_(scale),
      height_(static_cast<int>(dither.shape(0))),
      width_(static_cast<int>(dither.shape(1))),
      whole_width_(whole_blocks(width_)),
      dither_(static_cast<std::size_t>(height_) * whole_width_),
      ground_places_{Places(whole_width_), Places(whole_width_)},
      grain_places_{Places(whole_width_), Places(whole_width_)},
      row_(static_cast<std::size_t>(width_) * kChannels + kBytesBeyond) {
    for (int v = 0; v < height_; ++v) {
        const float *row = dither.data(v);
        float *whole = dither_.data() + static_cast<std::size_t>(v) * whole_width_;
        std::fill(std::copy_n(row, width_, whole), whole + whole_width_, row[width_ - 1]);
    }
}

void Ground::sample(Bytes out, const Sight &sight, const Whole &hidden) {
    require(out.ndim() == 3 && out.shape(0) == height_ && out.shape(1) == width_ &&
                out.shape(2) == kChannels && sight.height() == height_ && sight.width() == width_,
            "picture, sight and dither are of one size");
    require(hidden.size() == height_ && std::all_of(hidden.data(), hidden.data() + height_,
                                                    [this](std::int32_t columns) {
                                                        return 0 <= columns && columns <= width_;
                                                    }),
            "so many columns are hidden in each row, no more than it has");
    View view{sight.fall(),
              sight.density(0, kSteps * ruler_.along.texel_m),
              sight.density(1, kSteps * ruler_.across.texel_m),
              Linear(sight.coordinate(0, ruler_.along.unit_m, ruler_.along.origin)),
              Linear(sight.coordinate(1, ruler_.across.unit_m, ruler_.across.origin)),
              Linear(sight.coordinate_in_tile(0, ruler_.tile_m)),
              Linear(sight.coordinate_in_tile(1, ruler_.tile_m))};
    const int first_grain_row = sight.first_row_nearer_than(ruler_.grain_reach_m);
    const std::size_t stride = static_cast<std::size_t>(width_) * kChannels;
    std::uint8_t *target = out.mutable_data();
    const float *dither = dither_.data();
    const auto &[column_falls, row_falls] = view.fall;
    const float steepest = std::max(column_falls.front(), column_falls.back());
    for (Parts *parts : {&view.fall, &view.density_along, &view.density_across}) {
        parts->by_column.resize(whole_width_, parts->by_column.back());
    }
    int top = 0;
    while (top < height_ && steepest + row_falls[top] <= 0) {
        ++top;
    }
    // The grain of a row is prefetched while the previous row is read: it is spread over more
    // memory than a core's cache holds; the ground of a row is not.
    for (int v = top; v <= height_; ++v) {
        if (v < height_) {
            Places &ground = ground_places_[v % 2], &grain = grain_places_[v % 2];
            const bool grained = v >= first_grain_row;
            const int first = hidden.data()[v] / kBlock * kBlock;
            find_places(view, ruler_, v, first, whole_width_,
                        dither + static_cast<std::size_t>(v) * whole_width_, grained, atlas_,
                        grain_, ground, grain);
            if (grained) {
                ask_for(grain_, grain, first, width_);
            }
        }
        if (v > top) {
            const Layer ground{&atlas_, &ground_places_[(v - 1) % 2], {}};
            const Layer grain{v > first_grain_row ? &grain_ : nullptr, &grain_places_[(v - 1) % 2],
                              neutral_};
            const int first = hidden.data()[v - 1], skipped = first * kChannels;
            multiply_row(ground, grain, scale_, first / kBlock * kBlock, width_, row_.data());
            std::memcpy(target + (v - 1) * stride + skipped, row_.data() + skipped,
                        stride - skipped);
        }
    }
}

}  // namespace pixels
