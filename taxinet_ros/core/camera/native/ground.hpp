// The ground seen through a pinhole: what ground_view.py asks for.

#pragma once

#include <array>
#include <vector>

#include "common.hpp"
#include "sight.hpp"
#include "texture.hpp"

namespace pixels {

// One axis of the ground's texture.
struct Axis {
    // Of the coordinate and of its beginning; and the size of the texels that footprints are
    // measured in. The coordinate is counted from the far end of the ripmap.
    double unit_m, origin, texel_m;
    // Limits of the coordinate, that far end in texels, and the scale of the coarsest level.
    float least, most, end, coarsest;

    // A level's scale is 1 or less; one with more pixels than texels reads the finest.
    INLINE float on_level(float coordinate, float level) const {
        return clipped(coordinate, least, most) * clipped(level, coarsest, 1.0F) + end;
    }
};

// The bent ruler across the runway: fine between two coarse coordinates, by a factor more than 1;
// coarse outside of them, which is so many levels.
struct Bend {
    float least, most, factor, threshold;
    std::int32_t levels;
};

// One axis of the grain, which repeats: whole tiles are taken off a place before it is scaled to
// texels. No level is too coarse, for the ripmap's far end repeats its last one.
struct Tile {
    float texels, two_tiles, finest, end;

    INLINE float on_level(float place, float level) const {
        const float whole = __builtin_floorf(place);
        const float start = __builtin_fmaf(whole, -texels, -two_tiles);
        const float part = __builtin_fmaf(place, texels, start);
        return part * (level > finest ? finest : level) + end;
    }
};

// What of the way from a pixel to its texels depends neither on the pose nor on the light.
struct Ruler {
    float least_fall;
    Axis along, across;
    Bend bend;
    Tile grain_along, grain_across;
    double tile_m, grain_reach_m;
};

class Ground {
  public:
    // Dither and pictures are of one size; neutral and scale: what the grain is where it is not
    // looked up, and the factor on the product of it and the ground.
    Ground(Bytes atlas, Bytes grain, Floats dither, const Ruler &ruler,
           const std::array<int, 3> &neutral, float scale);

    // Fills a picture with the ground as one pose sees it, but for so many columns at the left of
    // each row.
    void sample(Bytes out, const Sight &sight, const Whole &hidden);

  private:
    Texture atlas_, grain_;
    Floats dither_;
    Ruler ruler_;
    std::array<int, 3> neutral_;
    float scale_;
    int height_, width_;
    std::array<Places, 2> ground_places_, grain_places_;
    std::vector<std::uint8_t> row_;
};

}  // namespace pixels
