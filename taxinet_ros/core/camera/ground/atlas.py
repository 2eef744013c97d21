"""Ground textures: a whole runway strip as one ripmap, and a tile of fine grain.

The strip starts 100 m before the runway and has rows of 0.4 m. Columns are 0.12 m wide up to a few
metres beyond the runway's edges, for sharp paint, and 0.9 m wide for another 144 m. The atlas of
KMWH 04 (8,192 rows, fine to 19.2 m, coarse to 163 m from the centreline) has 63 MB. Each process
generates it in memory in a few tenths of a second; nothing is stored on disk.

A run along a track that leaves the runway has an atlas of its own: the part of the strip around the
track, with columns that are fine as far to the side as the track goes.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.ground.pavement import (
    Grid,
    GroundStyle,
    crossing_rows,
    crossing_surface,
    crossings,
    pavement_colours,
    runway_surface,
    standard_style,
)
from taxinet_ros.core.camera.ground.taxiway import lay_airport, paint_track, pave_track
from taxinet_ros.core.camera.texture import Floats, build_ripmap, smooth_noise, white_noise
from taxinet_ros.core.place.place import AirportGround
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import Track

ROW_M, ROW_LEVELS = 0.4, 10
START_X_M = -100.0
COLUMN_LEVELS = 6
FINE_M, COARSE_M = 0.12, 0.9
SIDE_COLUMNS = 160
_LEAST_BEYOND_M, _LEAST_BESIDE_M = 60.0, 3.9

_SHOULDER = 0.84
"""Brightness of paved shoulders, of the runway's."""
GRAIN_TEXELS, GRAIN_M, GRAIN_LEVELS = 512, 0.012, 8
GRAIN_NEUTRAL = 128
"""Neutral grain code: the product is scaled by its inverse."""


_one_at_a_time = threading.Lock()
"""Who needs an atlas that another thread makes waits for it, rather than make it once more."""

_TRACK_ROW_M, _TRACK_FINE_M = 0.25, 0.15
_TRACK_MOST, _TRACK_BLOCK, _TRACK_LEVELS = (3072, 2560), 512, 10
"""Rows and columns of a track's atlas at most: along a longer one texels are larger."""
_TRACK_BEHIND_M, _TRACK_AHEAD_M, _TRACK_BESIDE_M = 60.0, 300.0, 20.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Layout:
    """Where the texels of an atlas lie; the default is a runway's.

    Attributes:
        rows, columns: of the finest level.
        start_x_m: where the first row begins [m].
        row_m, fine_m, coarse_m: sizes of rows, and of columns in the middle and beside it [m].
        middle_y_m: y of the middle of the columns [m].
        column_levels: number of levels of the ripmap across.
    """

    rows: int
    columns: int
    start_x_m: float = START_X_M
    row_m: float = ROW_M
    fine_m: float = FINE_M
    coarse_m: float = COARSE_M
    middle_y_m: float = 0.0
    column_levels: int = COLUMN_LEVELS

    @property
    def fine_half_m(self) -> float:
        """How far from the middle the columns are fine [m]."""
        return (self.columns - 2 * SIDE_COLUMNS) / 2 * self.fine_m


def ground_atlas(
    runway: Runway, track: Track | None = None, airport: AirportGround | None = None, *,
    crossing: bool = True,
) -> NDArray[np.uint8]:
    """Atlas of a runway in its standard style, made once per process.

    Args:
        runway: the runway.
        track: that leaves the runway, if one does; shown with its paint and pavement.
        airport: other pavement and paint, if known.
        crossing: whether crossing runways are drawn.
    """
    with _one_at_a_time:
        return _kept_atlas(runway, track, airport, crossing)


@lru_cache(maxsize=4)
def _kept_atlas(
    runway: Runway, track: Track | None, airport: AirportGround | None, crossing: bool
) -> NDArray[np.uint8]:
    # One key for equal arguments: given by name or left out, they would each have an atlas.
    return make_ground_atlas(standard_style(runway, crossing=crossing), runway, track, airport)


@lru_cache(maxsize=16)
def ground_layout(runway: Runway, track: Track | None = None) -> Layout:
    """Layout of the atlas of a runway, or of a track at it: whole blocks of the coarsest level."""
    if track is not None and not track.is_runway:
        return _track_layout(runway, track)
    rows = (runway.length_m - START_X_M + _LEAST_BEYOND_M) / ROW_M
    fine = 2 * (runway.half_width_m + runway.shoulder_m + _LEAST_BESIDE_M) / FINE_M
    row_block, column_block = 2 ** (ROW_LEVELS - 1), 2 ** COLUMN_LEVELS
    return Layout(
        rows=row_block * math.ceil(rows / row_block),
        columns=2 * SIDE_COLUMNS + column_block * math.ceil(fine / column_block),
    )


def _track_layout(runway: Runway, track: Track) -> Layout:
    """The ground around a track, with the runway beside it as far as it is near."""
    x, y = np.array(track.edge(0.0, track.samples(5.0))).T
    beside_m = track.half_width_m + _TRACK_BESIDE_M
    start_m = x.min() - _TRACK_BEHIND_M
    along_m = x.max() + _TRACK_AHEAD_M - start_m
    band_m = runway.half_width_m + runway.shoulder_m + _LEAST_BESIDE_M
    low_m, high_m = min(y.min() - beside_m, -band_m), max(y.max() + beside_m, band_m)
    most_rows, most_columns = _TRACK_MOST
    row_m = max(_TRACK_ROW_M, along_m / most_rows)
    fine_m = max(_TRACK_FINE_M, (high_m - low_m) / (most_columns - 2 * SIDE_COLUMNS))

    def blocks(texels: float) -> int:
        return _TRACK_BLOCK * math.ceil(round(texels, 6) / _TRACK_BLOCK)

    return Layout(
        rows=blocks(along_m / row_m),
        columns=blocks((high_m - low_m) / fine_m + 2 * SIDE_COLUMNS),
        start_x_m=float(start_m), row_m=float(row_m), fine_m=float(fine_m),
        coarse_m=float(fine_m) * COARSE_M / FINE_M, middle_y_m=float(low_m + high_m) / 2,
        column_levels=_TRACK_LEVELS,
    )


def make_ground_atlas(
    style: GroundStyle, runway: Runway, track: Track | None = None,
    airport: AirportGround | None = None,
) -> NDArray[np.uint8]:
    """Ripmap of the ground's daylight colours, (2 * rows, 2 * columns, 3) uint8 RGB, read-only."""
    if track is not None and not track.is_runway:
        return _make_track_atlas(style, runway, track, airport)
    layout = ground_layout(runway)
    rows, columns, half_m = layout.rows, layout.columns, layout.fine_half_m
    base = np.empty((rows, columns, 3), np.uint8)
    fine = Grid(rows=rows, columns=columns - 2 * SIDE_COLUMNS, x0_m=START_X_M, dx_m=ROW_M,
                y0_m=-half_m, dy_m=FINE_M)  # fmt: skip
    surface = runway_surface(fine, style, runway)
    base[:, SIDE_COLUMNS:-SIDE_COLUMNS] = cv2.LUT(
        cv2.merge([surface] * 3), pavement_colours(style)
    )
    blocks = [(base[:, SIDE_COLUMNS:-SIDE_COLUMNS], fine)]
    for side in (-1, 1):
        start = half_m if side > 0 else -half_m - SIDE_COLUMNS * COARSE_M
        grid = Grid(rows=rows, columns=SIDE_COLUMNS, x0_m=START_X_M, dx_m=ROW_M,
                    y0_m=start, dy_m=COARSE_M)  # fmt: skip
        target = base[:, :SIDE_COLUMNS] if side < 0 else base[:, -SIDE_COLUMNS:]
        target[:] = _field(grid, style, runway, seed=style.seed + 60 + side)
        blocks.append((target, grid))
    _shoulders(base, fine, style, runway)
    if airport is not None:
        for block, grid in blocks:
            lay_airport(block, grid, style, runway, airport)
    atlas = build_ripmap(base, ROW_LEVELS, COLUMN_LEVELS)
    atlas.flags.writeable = False
    return atlas


def _make_track_atlas(
    style: GroundStyle, runway: Runway, track: Track, airport: AirportGround | None
) -> NDArray[np.uint8]:
    layout = ground_layout(runway, track)
    rows, columns = layout.rows, layout.columns
    base = np.empty((rows, columns, 3), np.uint8)
    left_m = layout.middle_y_m - layout.fine_half_m
    right_m = layout.middle_y_m + layout.fine_half_m
    for number, (first, count, y0_m, dy_m) in enumerate((
        (0, SIDE_COLUMNS, left_m - SIDE_COLUMNS * layout.coarse_m, layout.coarse_m),
        (SIDE_COLUMNS, columns - 2 * SIDE_COLUMNS, left_m, layout.fine_m),
        (columns - SIDE_COLUMNS, SIDE_COLUMNS, right_m, layout.coarse_m),
    )):
        grid = Grid(rows=rows, columns=count, x0_m=layout.start_x_m, dx_m=layout.row_m,
                    y0_m=y0_m, dy_m=dy_m)  # fmt: skip
        block = base[:, first:first + count]
        finer = round(layout.coarse_m / dy_m)
        open_ground = Grid(rows=rows // 2, columns=count // finer, x0_m=layout.start_x_m,
                           dx_m=2 * layout.row_m, y0_m=y0_m, dy_m=finer * dy_m)  # fmt: skip
        field = _field(open_ground, style, runway, seed=style.seed + 59 + number)
        block[:] = cv2.resize(field, (count, rows))
        if number == 1:
            _lay_runway(block, grid, style, runway)
        pave_track(block, grid, style, runway, track)
        if airport is not None:
            lay_airport(block, grid, style, runway, airport)
        paint_track(block, grid, style, runway, track)
    atlas = build_ripmap(base, ROW_LEVELS, layout.column_levels)
    atlas.flags.writeable = False
    return atlas


def _lay_runway(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle, runway: Runway
) -> None:
    """The runway, between its edges and between the fillets of what crosses it."""
    reach_m = runway.half_width_m + runway.shoulder_m + _LEAST_BESIDE_M
    first, end = math.ceil(grid.column(-reach_m)), math.floor(grid.column(reach_m))
    band = Grid(rows=grid.rows, columns=end - first, x0_m=grid.x0_m, dx_m=grid.dx_m,
                y0_m=grid.y0_m + first * grid.dy_m, dy_m=grid.dy_m)  # fmt: skip
    surface = runway_surface(band, style, runway)
    colours = np.asarray(cv2.LUT(cv2.merge([surface] * 3), pavement_colours(style)), np.uint8)
    _darken_shoulders(colours, band, style, runway)
    x, y = band.centres(slice(0, band.rows))
    paved = np.abs(y) <= runway.half_width_m + runway.shoulder_m
    for crossing in crossings(style, runway):
        low_m, high_m = crossing.paved_m
        paved = paved | ((x >= low_m) & (x <= high_m))
    target = block[:, first:end]
    np.copyto(target, colours, where=np.broadcast_to(paved[:, :, None], target.shape))


def _field(grid: Grid, style: GroundStyle, runway: Runway, seed: int) -> NDArray[np.uint8]:
    """Ground beside the runway, near tint to far tint, with the crossings; RGB codes."""
    value = _dry_texture(grid, seed)
    _, y = grid.centres(slice(0, 1))
    grass = np.clip((np.abs(y[0]) - 55) / 40, 0, 1)[:, None]
    near, far = (np.array(t, np.float32) for t in (style.near_tint, style.far_tint))
    tint = near + (far - near) * grass
    colour = value[:, :, None] * tint[None]
    for crossing in crossings(style, runway):
        rows = crossing_rows(grid, crossing, max(abs(y[0, 0]), abs(y[0, -1])))
        surface, share = crossing_surface(*grid.centres(rows), grid.dy_m, style, crossing)
        tinted = surface[:, :, None] * np.array(style.asphalt_tint, np.float32)
        colour[rows] += share[:, :, None] * (tinted - colour[rows])
    codes: NDArray[np.uint8] = np.clip(colour, 0, 255).astype(np.uint8)
    return codes


def _dry_texture(grid: Grid, seed: int) -> Floats:
    """Brightness factor near 1 of open ground: mottled, with a few dark transverse cracks."""
    finer_along, finer_across = ROW_M / grid.dx_m, COARSE_M / grid.dy_m
    value = smooth_noise(seed, grid.shape, (30 * finer_along, 10 * finer_across))
    value *= np.float32(0.02)
    value += np.float32(0.025) * smooth_noise(
        seed + 10, grid.shape, (300 * finer_along, 30 * finer_across)
    )
    value += np.float32(0.015) * white_noise(seed + 20, grid.shape)
    value += np.float32(1.0)
    rng = np.random.default_rng(seed + 30)
    for row in rng.integers(0, grid.rows, 60):
        value[row : row + 2, : round(70 * finer_across)] *= np.float32(0.88)
    return value


def _shoulders(
    base: NDArray[np.uint8], fine: Grid, style: GroundStyle, runway: Runway
) -> None:
    """Draw the bare ground between the pavement's edge and the end of the fine columns."""
    _darken_shoulders(base[:, SIDE_COLUMNS:-SIDE_COLUMNS], fine, style, runway)
    first = round(fine.column(runway.half_width_m + runway.shoulder_m))
    count = fine.columns - first
    for side in (-1, 1):
        seed = style.seed + 80 + side
        noise = white_noise(seed, (fine.rows, count)) * np.float32(0.02)
        noise += smooth_noise(seed + 10, noise.shape, (10, 6)) * np.float32(0.02)
        noise += np.float32(1.0)
        tinted = noise[:, :, None] * np.array(style.near_tint, np.float32)
        colour = np.clip(tinted, 0, 255).astype(np.uint8)
        middle = base.shape[1] // 2
        edge = middle + side * (first - fine.columns // 2)
        columns = slice(edge, edge + count) if side > 0 else slice(edge - count, edge)
        bare = np.ones(fine.rows, bool)
        for crossing in crossings(style, runway):
            paved = (min(max(round(fine.row(x)), 0), fine.rows) for x in crossing.paved_m)
            bare[slice(*paved)] = False
        base[bare, columns] = colour[bare]


def _darken_shoulders(
    block: NDArray[np.uint8], grid: Grid, style: GroundStyle, runway: Runway
) -> None:
    """Make the paved shoulders darker than the runway, which is cleaned and swept."""
    if not runway.shoulder_m:
        return
    x, y = grid.centres(slice(0, grid.rows))
    beside = (np.abs(y) > runway.half_width_m) & np.ones(x.shape, bool)
    for crossing in crossings(style, runway):
        low_m, high_m = crossing.paved_m
        beside &= (x < low_m) | (x > high_m)
    block[beside] = np.rint(block[beside] * np.float32(_SHOULDER)).astype(np.uint8)


def grain_atlas() -> NDArray[np.uint8]:
    """Ripmap of a 6.1 m tile of fine grain around GRAIN_NEUTRAL; multiplies the colour."""
    with _one_at_a_time:
        return _kept_grain()


@cache
def _kept_grain() -> NDArray[np.uint8]:
    size = (GRAIN_TEXELS, GRAIN_TEXELS)
    grey = np.zeros(size, np.float32)
    for seed, blur_texels, amount in ((91, 0.4, 0.062), (92, 1.3, 0.022), (93, 4.0, 0.014)):
        grey += amount * _tile_noise(seed, blur_texels)
    tile = np.stack([grey + 0.012 * _tile_noise(seed, 1.5) for seed in (94, 95, 96)], axis=2)
    coded = np.clip(np.rint(GRAIN_NEUTRAL * (1 + tile)), 0, 255).astype(np.uint8)
    atlas = build_ripmap(coded, GRAIN_LEVELS, GRAIN_LEVELS)
    atlas.flags.writeable = False
    return atlas


def _tile_noise(seed: int, blur_texels: float) -> Floats:
    """Smooth noise of deviation 1, periodic at the tile's borders."""
    noise = np.random.default_rng(seed).standard_normal((GRAIN_TEXELS,) * 2, dtype=np.float32)
    pad = 32
    wide = np.pad(noise, pad, mode='wrap')
    soft = cv2.GaussianBlur(wide, (0, 0), blur_texels)[pad:-pad, pad:-pad]
    scaled: Floats = (soft / soft.std()).astype(np.float32)
    return scaled
