"""Per-pixel operations of the camera and of the network's input, compiled from ``native/``.

Equal arguments give equal bytes on every processor, except that the last bit of angles and
exponentials (one per row or column) depends on the C library. Arrays are never converted
implicitly: one of the wrong type, shape or order (C) raises ``ValueError`` or ``TypeError``.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_Bytes = NDArray[np.uint8]
_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Three = tuple[float, float, float]
_Four = tuple[float, float, float, float]
_Drawing = tuple[slice, slice, int, list[NDArray[np.int32]]]

class Sight:
    """Ground projection of one pose: the parameters that determine every pixel's texels.

    With the ray of pixel (u, v) as d = A (u, v, 1) in ``map`` and the camera at height h above the
    point c, the ground point is c + h (dx, dy) w with w = -1/dz.
    """

    def __init__(self, rays: _Doubles, camera: _Doubles, height: int, width: int) -> None:
        """Store A, (3, 3), the camera position in ``map`` (3,) [m], and the image size [px]."""

    def fall(self) -> tuple[_Floats, _Floats]:
        """Two summands of -dz: by column (width,), and by row (height,)."""

    def density(self, axis: int, texel_m: float) -> tuple[_Floats, _Floats]:
        """Factors on (dz)^2 that give pixels per texel along an axis of ``map``.

        The first is for the footprint's side along v, by column (width,); the second for the side
        along u, by row (height,). The smaller one applies.
        """

    def coordinate(self, axis: int, unit_m: float, origin: float) -> _Three:
        """Ground coordinate along an axis in units of ``unit_m``, plus ``origin``.

        Returns:
            Factors on u w and on w, and a constant.
        """

    def first_row_nearer_than(self, reach_m: float) -> int:
        """First row whose middle is within ``reach_m`` ahead; the number of rows if none."""

class Ruler:
    """Part of the pixel-to-texel mapping that depends on neither pose nor light."""

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
        """Set the dimensions of the textures.

        Args:
            least_fall: minimum of -dz; pixels above it use the ground at this value.
            along: along the runway: unit of the coordinate [m], its origin, and texel size for
                footprints [m].
            along_limits: minimum and maximum of the coordinate, counted from the far end of the
                ripmap; that end; and the scale of the coarsest level.
            across: like ``along``, across the runway.
            across_limits: like ``along_limits``, across the runway.
            bend: start and end of the fine columns across the runway, the factor, minus 1, by which
                they are finer, and the distance from them that counts as outside.
            bend_levels: number of levels between fine and coarse columns.
            grain_along: texels of a grain tile in the footprints' unit, twice that, the scale of
                the finest level, and the end of the ripmap.
            grain_across: like ``grain_along``, across the runway.
            tile_m: size of a grain tile [m].
            grain_reach_m: distance ahead up to which grain is drawn [m].
        """

class Ground:
    """The ground's textures, ready for rendering. Not thread-safe."""

    def __init__(
        self,
        atlas: _Bytes,
        grain: _Bytes,
        dither: _Floats,
        ruler: Ruler,
        neutral: tuple[int, int, int],
        scale: float,
    ) -> None:
        """Store the textures without copying them.

        Args:
            atlas: ripmap of the ground's colours, (rows, columns, 3).
            grain: ripmap of the grain factor on them, (rows, columns, 3).
            dither: factor on the footprints' density, (height, width) of the images.
            ruler: dimensions of both textures.
            neutral: grain value used beyond the grain's reach.
            scale: factor on the product of ground and grain.
        """

    def sample(self, out: _Bytes, sight: Sight, hidden: NDArray[np.int32]) -> None:
        """Render the ground for one pose.

        Args:
            out: output image, (height, width, 3).
            sight: ground projection of the pose.
            hidden: number of columns at the left of each row that are not rendered, (height,).
        """

class Air:
    """Atmosphere of one scenario: effects of haze, water and a low sun on rows and columns."""

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
        """Set the parameters.

        Args:
            visibility_m: distance at which haze reduces contrast to 1/e [m].
            film: share of the ground covered by water, 0..1.
            spray: opacity of the uniform spray, 0..1.
            sky_low: display colour of the sky at the horizon, 0..255.
            sky_high: display colour of the sky 15 degrees up, 0..255.
            glare: brightness of the glare, in display codes.
            sun_yaw_rad: direction of the sun in ``map`` [rad].
            glare_width_rad: half of the glare's width [rad].
        """

    def veil(
        self, rays: _Doubles, height_m: float, height: int, width: int
    ) -> tuple[_Doubles, _Doubles]:
        """Effect of haze and of the sky's reflection in water on the upper rows of the ground.

        Args:
            rays: maps a homogeneous pixel to a direction in ``map``, (3, 3).
            height_m: camera height above ground [m].
            height: image height [px].
            width: image width [px].

        Returns:
            Remaining share of the ground's colour in each row, in 255ths (n,), and the added colour
            (n, 3).
        """

    def shine(self, rays: _Doubles, height: int, width: int) -> tuple[_Floats, _Floats] | None:
        """Broad glare on the ground under a low sun, strongest at grazing angles.

        Returns:
            Strength by row (height,) and by column (width,), for :func:`add_shine`; None if the sun
            is too far to the side.
        """

class Panorama:
    """Panorama above the end of the ground."""

    def __init__(
        self, codes: _Bytes, lowest_rad: float, step_rad: float, end_tan: float, spacing_px: int
    ) -> None:
        """Store the panorama without copying it.

        Args:
            codes: display colours (rows, columns, 3). Columns cover 360 degrees from yaw -pi.
            lowest_rad: elevation of row 0 [rad].
            step_rad: elevation step between rows [rad].
            end_tan: tangent of the depression at which the ground ends.
            spacing_px: spacing of the image columns for which directions are computed, odd;
                directions are interpolated between them.
        """

    def lay_over(self, picture: _Bytes, rays: _Doubles) -> None:
        """Draw the panorama above the end of the ground, in place.

        Args:
            picture: image (height, width, 3); its width is a multiple of the spacing.
            rays: maps a homogeneous pixel to a direction in ``map``, (3, 3).
        """

class Reduction:
    """Reduces frames to grey images, in bands from the top, each with its own row ratio."""

    def __init__(
        self, height: int, width: int, bands: Sequence[tuple[int, int]], columns: int
    ) -> None:
        """Prepare the weights.

        Args:
            height: frame height [px].
            width: frame width [px].
            bands: number of frame rows and of output rows of each band.
            columns: output width [px], at least half of the frame's.
        """

    def reduce(self, frame: _Bytes) -> _Bytes:
        """Reduce a frame (height, width, 3) RGB to grey levels (rows, columns), a new array.

        Luma of ITU-R BT.601, averaged over areas; the values equal OpenCV's.
        """

class Warp:
    """Resamples frames to grey images: each pixel is the mean of 16 samples of the frame."""

    def __init__(
        self, height: int, width: int, places: NDArray[np.int32], unseen: int
    ) -> None:
        """Work out which pixels of a frame count how much.

        Args:
            height: frame height [px].
            width: frame width [px].
            places: positions of the samples in the frame, across and down, in steps of 1/32 pixel,
                (rows, columns, 16, 2).
            unseen: grey level of samples that lie outside the frame.
        """

    def look(self, frame: _Bytes) -> _Bytes:
        """Grey levels (rows, columns), a new array, of a frame (height, width, 3) RGB.

        Luma of ITU-R BT.601, interpolated between four pixels at each sample; whole numbers only.
        """

class Convolution:
    """A layer of a network: a convolution, or a dense layer, whose kernel is its whole input."""

    def __init__(
        self, weights: _Floats, biases: _Floats, *, stride: int, padding: int, rectified: bool
    ) -> None:
        """Store the layer.

        Args:
            weights: (rows, columns, input channels, output channels).
            biases: (output channels,).
            stride: steps of the kernel, along both axes.
            padding: zeros around the input, on each side.
            rectified: whether negative outputs become 0; NaN stays.
        """

class Network:
    """Convolutions one after the other; equal results on every processor, to the bit.

    An output starts at its bias; the products of single precision are added one by one, by row,
    column and input channel of the kernel, each sum rounded.
    """

    def __init__(self, height: int, width: int, layers: Sequence[Convolution]) -> None:
        """Join the layers; the last has one row and column. ``height``, ``width``: the input's."""

    def infer(self, pictures: _Floats) -> _Floats:
        """Outputs (N, output channels) for pictures (N, height, width, channels)."""

class Shadow:
    """Casts the shadows of the convex parts of a body on level ground."""

    def __init__(
        self,
        corners: _Doubles,
        starts: Sequence[int],
        sun: Sequence[float] | _Doubles,
        intrinsics: _Doubles,
        size: tuple[int, int],
        nearest_m: float,
        farthest_px: float,
        edge_px: int,
    ) -> None:
        """Store the parts.

        Args:
            corners: corners of all parts, (N, 3), in the body frame [m].
            starts: index of the first corner of each part, in order.
            sun: unit vector towards the sun in ``map``; its z is positive.
            intrinsics: camera matrix, (3, 3), without skew.
            size: image height and width [px].
            nearest_m: minimum depth; shadows are clipped there.
            farthest_px: limit to which pixel coordinates are clamped.
            edge_px: width of the shadows' soft edge.
        """

    def outlines(
        self, body: _Doubles, place: _Three, to_optical: _Doubles, camera: _Doubles
    ) -> tuple[slice, slice, list[NDArray[np.int32]]] | None:
        """Project the shadows into the image.

        Args:
            body: rotation from the body frame to ``map``, (3, 3).
            place: place of the body in ``map`` [m].
            to_optical: rotation from ``map`` to the camera's optical frame, (3, 3).
            camera: place of the camera in ``map``, (3,) [m].

        Returns:
            Rows and columns of the image that they may touch, and for each part points (n, 2) in
            sixteenths of a pixel, whose convex hull is its outline; None if they are not in view.
        """

class Pinhole:
    """A camera that sees what stands or lies on the ground.

    What is to be drawn is given by the rows and columns of the image that it may touch, how many
    times finer it is drawn there, and convex polygons (n, 2) in sixteenths of a finer pixel.
    """

    def __init__(
        self, intrinsics: _Doubles, size: tuple[int, int], nearest_m: float, farthest_px: float
    ) -> None:
        """Set the camera.

        Args:
            intrinsics: camera matrix, (3, 3), without skew.
            size: image height and width [px].
            nearest_m: minimum depth; parts are clipped there.
            farthest_px: limit to which pixel coordinates are clamped.
        """

    def cover(
        self,
        corners: _Doubles,
        starts: Sequence[int],
        pose: Sequence[float],
        cast: _Doubles,
        to_optical: _Doubles,
        camera: Sequence[float] | _Doubles,
        margin_px: int,
    ) -> _Drawing | None:
        """Outlines of convex parts, as they are cast on the ground; None if not in view.

        Args:
            corners: corners of all parts, (N, 3), in a frame of their own [m].
            starts: index of the first corner of each part, in order.
            pose: x and y [m] and heading [rad] of that frame in ``map``.
            cast: takes points in ``map`` to the ground, (3, 3).
            to_optical: rotation from ``map`` to the camera's optical frame, (3, 3).
            camera: place of the camera in ``map``, (3,) [m].
            margin_px: pixels around the outlines that belong to the drawing.
        """

    def faces(
        self,
        corners: _Doubles,
        starts: Sequence[int],
        about: _Doubles,
        pose: Sequence[float],
        to_optical: _Doubles,
        camera: Sequence[float] | _Doubles,
    ) -> tuple[_Drawing, list[int]] | None:
        """Flat faces that look at the camera, from far to near, and the number of each.

        Args:
            corners: as of :meth:`cover`, of all faces.
            starts: index of the first corner of each face, in order.
            about: of each face its middle, its normal, and the point whose distance counts,
                (3 faces, 3); of those with the same distance, the first is the farthest.
            pose: as of :meth:`cover`.
            to_optical: as of :meth:`cover`.
            camera: as of :meth:`cover`.
        """

def gap(corners: _Doubles, starts: Sequence[int], polygon: _Doubles) -> float:
    """Least distance in plan of a convex polygon to others [m]; 0 where it overlaps one.

    Args:
        corners: corners of the others, (N, 3), counter-clockwise [m]; their height does not count.
        starts: index of the first corner of each, in order.
        polygon: corners of the polygon, (n, 3), as theirs.
    """

def tint_rows(picture: _Bytes, shares: _Doubles) -> None:
    """Multiply each row, in place, by a share in 255ths per channel, (rows, 3)."""

def tint_masked(picture: _Bytes, mask: _Bytes, depth: Sequence[float] | _Doubles) -> None:
    """Darken a part of an image, in place, where a mask (rows, columns) is not 0.

    Args:
        picture: the part; its rows may be non-contiguous.
        mask: 255 for full darkening.
        depth: full darkening per channel, 0..1.
    """

def pose(
    numbers: tuple[float, ...], body_to_optical: _Doubles, offset: _Three
) -> tuple[_Doubles, _Doubles, _Doubles]:
    """Rotations body to ``map`` and ``map`` to optical, (3, 3), and the camera in ``map``, (3,).

    Args:
        numbers: the aircraft's place in ``map`` [m], and its roll, pitch and yaw [rad].
        body_to_optical: rotation (3, 3).
        offset: the camera in the body frame [m].
    """

def average(canvas: _Bytes, picture: _Bytes) -> None:
    """Reduce a canvas, 2, 4 or 8 times as high and as wide, to a part of an image, in place.

    As OpenCV's ``INTER_AREA``, to the bit.

    Args:
        canvas: of a mask its codes; else (rows, columns, 4): a colour, and 1 where it is drawn, or
            four zeros, through which the picture is seen.
        picture: the mask (rows, columns), or the part (rows, columns, 3), whose rows may be
            non-contiguous.
    """

def blend_masked(
    picture: _Bytes, mask: _Bytes, paint: Sequence[float] | _Doubles, opacity: float
) -> None:
    """Paint a part of an image, in place, where a mask (rows, columns) is not 0.

    Args:
        picture: the part; its rows may be non-contiguous.
        mask: 255 for the full opacity.
        paint: code of each channel, 0..255.
        opacity: share of the paint, 0..1.
    """

def develop(
    ground: _Bytes, curve: _Bytes, kept: _Doubles, added: _Doubles, picture: _Bytes
) -> None:
    """Light the ground and apply haze to the upper rows.

    Args:
        ground: daylight colours, (rows, columns, 3).
        curve: display code of each ground code, (256,).
        kept: remaining share in 255ths of each of the first n rows, (n,).
        added: colour added to them, (n, 3).
        picture: output image of the ground's size.
    """

def lay_over(picture: _Bytes, kept: _Bytes, added: _Bytes) -> None:
    """Blend a layer over a part of an image, in place.

    Args:
        picture: the part, (rows, columns, 3); its rows may be non-contiguous.
        kept: remaining share of each code in 255ths, of the same size.
        added: codes added, of the same size.
    """

def add_shine(
    picture: _Bytes, by_row: _Floats, by_column: _Floats, tint: tuple[float, float, float]
) -> None:
    """Add light, in place: the product of strengths by row, by column and by channel."""

def instruction_sets() -> list[str]:
    """Instruction-set extensions that are used on this processor; empty on old ones."""
