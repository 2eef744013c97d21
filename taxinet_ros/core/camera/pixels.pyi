"""What the camera and the network's input do once per pixel: compiled from ``native/``.

Equal arguments give equal bytes on every processor; only angles and exponentials, once per row or
column, are the C library's, whose last bit may differ. What is given is not copied in secret:
arrays are of the types and shapes that are said, in C order, or a ``ValueError`` or ``TypeError``
tells which is not.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_Bytes = NDArray[np.uint8]
_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Three = tuple[float, float, float]
_Four = tuple[float, float, float, float]

class Sight:
    """How one pose sees the ground: the few numbers from which every pixel's texels follow.

    With the ray of pixel (u, v) as d = A (u, v, 1) in ``map`` and the camera at height h over the
    place c, the ground point is c + h (dx, dy) w with w = -1/dz.
    """

    def __init__(self, rays: _Doubles, camera: _Doubles, height: int, width: int) -> None:
        """Take A, (3, 3), the camera's place in ``map`` (3,) [m], and the picture's size [px]."""

    def fall(self) -> tuple[_Floats, _Floats]:
        """The two parts of -dz: by column (width,), and by row (height,)."""

    def density(self, axis: int, texel_m: float) -> tuple[_Floats, _Floats]:
        """Factors on (dz)^2 that give pixels per texel along an axis of ``map``.

        Of the footprint's side along v, by column (width,); and of the one along u, by row
        (height,). The smaller one counts.
        """

    def coordinate(self, axis: int, unit_m: float, origin: float) -> _Three:
        """Ground coordinate along an axis in units of ``unit_m``, plus ``origin``.

        Returns:
            Factors on u w and on w, and a constant.
        """

    def first_row_nearer_than(self, reach_m: float) -> int:
        """First row whose middle lies within ``reach_m`` ahead; the number of rows if none."""

class Ruler:
    """What of the way from a pixel to its texels depends neither on the pose nor on the light."""

    def __init__(
        self,
        *,
        least_fall: float,
        along: _Three,
        along_limits: _Four,
        across: _Three,
        across_limits: _Four,
        bend: _Four,
        bend_levels: int,
        grain_along: _Four,
        grain_across: _Four,
        tile_m: float,
        grain_reach_m: float,
    ) -> None:
        """Take the measures of the textures.

        Args:
            least_fall: -dz from which on downwards the ground is looked up; above it is the last.
            along: along the runway, unit of the coordinate [m], its beginning, and the size of the
                texels that footprints are measured in [m].
            along_limits: least and most of it, counted from the far end of the ripmap, that end,
                and the scale of the coarsest level.
            across: the same across the runway.
            across_limits: the same.
            bend: ends of the fine part of the ruler across the runway, the factor, less 1, by which
                it is finer, and the distance from it that counts as outside.
            bend_levels: levels that the coarse part is coarser.
            grain_along: of the grain, texels of a tile at the footprints' unit, twice that, the
                finest level's scale, and the end of the ripmap.
            grain_across: the same across the runway.
            tile_m: size of a tile of grain [m].
            grain_reach_m: distance ahead to which there is grain [m].
        """

class Ground:
    """The ground's textures, ready to be photographed. Not to be shared between threads."""

    def __init__(
        self,
        atlas: _Bytes,
        grain: _Bytes,
        dither: _Floats,
        ruler: Ruler,
        neutral: tuple[int, int, int],
        scale: float,
    ) -> None:
        """Keep the textures; they are not copied.

        Args:
            atlas: ripmap of the ground's colours, (rows, columns, 3).
            grain: ripmap of the factor on them, (rows, columns, 3).
            dither: factor on the footprints' density, (height, width) of the pictures.
            ruler: measures of both.
            neutral: the grain where there is none.
            scale: factor on the product of ground and grain.
        """

    def sample(self, out: _Bytes, sight: Sight, hidden: NDArray[np.int32]) -> None:
        """Fill a picture with the ground as one pose sees it.

        Args:
            out: the picture, (height, width, 3).
            sight: of the pose.
            hidden: how many columns at the left of each row are left as they are, (height,).
        """

class Air:
    """The air of one scenario, its water and its low sun: what they add to rows and columns."""

    def __init__(
        self,
        *,
        visibility_m: float,
        film: float,
        spray: float,
        sky_low: Sequence[float] | _Doubles,
        sky_high: Sequence[float] | _Doubles,
        glare: float,
        sun_yaw_rad: float,
        glare_width_rad: float,
    ) -> None:
        """Take the measures.

        Args:
            visibility_m: distance at which haze leaves 1/e of a contrast [m].
            film: share of the ground that is covered by water, 0..1.
            spray: share of the picture that spray veils evenly, 0..1.
            sky_low: display colour of the sky at the horizon, 0..255.
            sky_high: display colour of the sky 15 degrees up, 0..255.
            glare: brightness of the glare, in display codes.
            sun_yaw_rad: direction of the sun in ``map`` [rad].
            glare_width_rad: half of the glare's width [rad].
        """

    def veil(
        self, rays: _Doubles, height_m: float, height: int, width: int
    ) -> tuple[_Doubles, _Doubles]:
        """What haze and, where wet, the sky's mirror image make of the upper rows of the ground.

        Args:
            rays: homogenous pixel to a direction in ``map``, (3, 3).
            height_m: the camera's height above ground [m].
            height: of the picture [px].
            width: of the picture [px].

        Returns:
            The share of its colour that each row keeps, in 255ths (n,), and what is added (n, 3).
        """

    def shine(self, rays: _Doubles, height: int, width: int) -> tuple[_Floats, _Floats] | None:
        """A broad shine on the ground under a low sun, strongest at grazing angles.

        Returns:
            Its strength by row (height,) and by column (width,), for :func:`add_shine`; None where
            the sun is too far aside.
        """

class Panorama:
    """What stands above the ground at the horizon."""

    def __init__(
        self, codes: _Bytes, lowest_rad: float, step_rad: float, end_tan: float, spacing_px: int
    ) -> None:
        """Keep the panorama; it is not copied.

        Args:
            codes: display colours (rows, columns, 3). Columns begin at yaw -pi and go round.
            lowest_rad: elevation of row 0 [rad].
            step_rad: elevation from one row to the next [rad].
            end_tan: tangent of the depression at which the ground ends.
            spacing_px: distance of the columns of a picture for which directions are computed,
                odd; they are interpolated in between.
        """

    def lay_over(self, picture: _Bytes, rays: _Doubles) -> None:
        """Replace what is above the end of the ground, in place.

        Args:
            picture: (height, width, 3), its width a multiple of the spacing.
            rays: homogenous pixel to a direction in ``map``, (3, 3).
        """

class Reduction:
    """Reduces frames to grey pictures, in bands from the top, each in a proportion of its own."""

    def __init__(
        self, height: int, width: int, bands: Sequence[tuple[int, int]], columns: int
    ) -> None:
        """Prepare the averages.

        Args:
            height: of a frame [px].
            width: of a frame [px].
            bands: rows of each band of it, and the rows that are made of them.
            columns: of the picture [px], at least half of the frame's.
        """

    def reduce(self, frame: _Bytes) -> _Bytes:
        """Grey levels (rows, columns), a new array, of a frame (height, width, 3) RGB.

        Luma after ITU-R BT.601, averaged over areas; the numbers are OpenCV's.
        """

def outlines(
    corners: _Doubles,
    starts: Sequence[int],
    intrinsics: _Doubles,
    size: tuple[int, int],
    nearest_m: float,
    farthest_px: float,
) -> list[NDArray[np.int32]]:
    """Where the convex parts of a body lie in the picture.

    Args:
        corners: of all parts, (N, 3), in the camera's optical frame [m].
        starts: index of the first corner of each part, in order.
        intrinsics: camera matrix, (3, 3), without skew.
        size: height and width of the picture [px].
        nearest_m: depth at which a part is cut off that comes nearer.
        farthest_px: distance from the picture's corner beyond which nothing is told.

    Returns:
        Of each part that may touch the picture, points (n, 2) in sixteenths of a pixel, whose hull
        is its outline.
    """

def tint_rows(picture: _Bytes, shares: _Doubles) -> None:
    """Keep of each row, in place, a share in 255ths by channel: (rows, 3)."""

def tint_masked(picture: _Bytes, mask: _Bytes, depth: Sequence[float] | _Doubles) -> None:
    """Darken a part of a picture, in place, where a mask (rows, columns) is not 0.

    Args:
        picture: the part; its rows may lie apart.
        mask: 255 for full darkness.
        depth: what that takes of each channel, 0..1.
    """

def develop(
    ground: _Bytes, curve: _Bytes, kept: _Doubles, added: _Doubles, picture: _Bytes
) -> None:
    """Make a lit picture of the ground, and lay a veil over its upper rows.

    Args:
        ground: daylight colours, (rows, columns, 3).
        curve: what becomes of each code, (256,).
        kept: share in 255ths that each of the first n rows keeps, (n,).
        added: what is added to it, (n, 3).
        picture: where it goes, of the ground's size.
    """

def lay_over(picture: _Bytes, kept: _Bytes, added: _Bytes) -> None:
    """Lay a picture over a part of one, in place: a share in 255ths of each code, and a sum.

    Args:
        picture: the part, (rows, columns, 3); its rows may lie apart.
        kept: the share that shines through, of the same size.
        added: what is added to it, of the same size.
    """

def add_shine(
    picture: _Bytes, by_row: _Floats, by_column: _Floats, tint: tuple[float, float, float]
) -> None:
    """Add light, in place: the product of a strength by row, one by column, one by channel."""

def instruction_sets() -> list[str]:
    """What is taken here of the code that is written for newer processors; none on old ones."""
