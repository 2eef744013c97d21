// The ground in a pinhole camera; used by ground/view.py.

#pragma once

#include <array>
#include <vector>

#include "common.hpp"
#include "sight.hpp"
#include "texture.hpp"

namespace pixels {

// One axis of the ground's texture.
struct Axis {
    // Unit and origin of the coordinate, and texel size for footprints. The coordinate is counted
    // from the far end of the ripmap.
    double unit_m, origin, texel_m;
    // Limits of the coordinate, the far end in texels, and the scales of the coarsest and of the
    // finest level.
    float least, most, end, coarsest, finest = 1.0F;

    // With more pixels than texels the finest level is read.
    INLINE float on_level(float coordinate, float level) const {
        return clipped(coordinate, least, most) * lesser(greater(level, coarsest), finest) + end;
    }
};

// Columns across the runway: finer between two coarse coordinates by a factor 1 + `factor`; coarser
// outside by `levels`.
struct Bend {
    float least, most, factor, threshold;
    std::int32_t levels;
};

// One axis of the periodic grain: whole tiles are subtracted from a coordinate before it is scaled
// to texels. No level is too coarse, because the ripmap's far end repeats its last one.
struct Tile {
    float texels, two_tiles, finest, end;

    INLINE float on_level(float place, float level) const {
        const float whole = __builtin_floorf(place);
        const float start = __builtin_fmaf(whole, -texels, -two_tiles);
        const float part = __builtin_fmaf(place, texels, start);
        return part * lesser(level, finest) + end;
    }
};

// Part of the pixel-to-texel mapping that depends on neither pose nor light.
struct Ruler {
    float least_fall;
    Axis along, across;
    Bend bend;
    Tile grain_along, grain_across;
    double tile_m, grain_reach_m;

    // Positions in steps of 1/32 texel, for levels scaled by as much; this rounds nothing.
    Ruler in_steps() const {
        Ruler ruler = *this;
        for (Axis *axis : {&ruler.along, &ruler.across}) {
            axis->end *= kSteps;
            axis->coarsest *= kSteps;
            axis->finest *= kSteps;
        }
        for (Tile *tile : {&ruler.grain_along, &ruler.grain_across}) {
            tile->end *= kSteps;
            tile->finest *= kSteps;
        }
        return ruler;
    }
};

class Ground {
  public:
    // Dither and images have the same size. neutral: grain value beyond the grain's reach; scale:
    // factor on the product of grain and ground.
    Ground(Bytes atlas, Bytes grain, const Floats &dither, const Ruler &ruler,
           const std::array<int, 3> &neutral, float scale);

    // Renders the ground for one pose, without the hidden columns at the left of each row and the
    // rows at the top that see nothing but sky.
    void sample(Bytes out, const Sight &sight, const Whole &hidden);

  private:
    Texture atlas_, grain_;
    Ruler ruler_;
    std::array<int, 3> neutral_;
    float scale_;
    int height_, width_, whole_width_;
    std::vector<float> dither_;  // of whole_width_ columns
    std::array<Places, 2> ground_places_, grain_places_;
    std::vector<std::uint8_t> row_;
};

}  // namespace pixels
