"""Texture of a runway surface: asphalt, joints, worn paint, tyre rubber, crossing runways.

A style contains the shades, wear and random seed of the textures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.texture import Floats, smooth_noise, white_noise
from taxinet_ros.core.place.markings import Marking, Polygon, markings
from taxinet_ros.core.place.runway import Crossing, Runway

Tint = tuple[float, float, float]
_OPTIONAL = ('threshold', 'designation', 'aiming', 'touchdown', 'centreline')


@dataclass(frozen=True, kw_only=True, slots=True)
class GroundStyle:
    """Appearance of the ground.

    Attributes:
        seed: seed of all random patterns: mottle, cracks, streaks, wear.
        asphalt, rubber, paint: display codes 0..255 in bright daylight.
        asphalt_tint, near_tint, far_tint: RGB factors of clean asphalt, and display codes of the
            bare ground beside the runway and of the grass farther out.
        mottle: strength of the asphalt's mottle, joints and cracks, 1 = as at KMWH.
        rubber_amount: amount of tyre rubber, 1 = as at KMWH.
        rubber_shift_m: lateral offset of its maximum, left of the centreline positive [m].
        wear: wear of the paint, 1 = as at KMWH.
        edge_wear: wear of the edge stripes, 0 = fresh.
        dash_scale, dash_shift_m: factor on lengths along the runway, and shift [m], of all paint
            except the edge stripes.
        without: kinds of marking (see :class:`~taxinet_ros.core.place.markings.Marking`) left out.
        crossing: whether crossing runways exist and interrupt pavement and paint.
    """

    seed: int = 0
    asphalt: float = 134.0
    rubber: float = 50.0
    paint: float = 206.0
    asphalt_tint: Tint = (1.05, 1.0, 0.91)
    near_tint: Tint = (164.0, 157.0, 135.0)
    far_tint: Tint = (133.0, 130.0, 97.0)
    mottle: float = 1.0
    rubber_amount: float = 1.0
    rubber_shift_m: float = 0.0
    wear: float = 1.0
    edge_wear: float = 0.0
    dash_scale: float = 1.0
    dash_shift_m: float = 0.0
    without: tuple[str, ...] = ()
    crossing: bool = True


STANDARD = GroundStyle()
"""KMWH 04, the standard style."""

_SURFACE_LOOKS: dict[str, dict[str, Any]] = {
    'asphalt': {},
    'concrete': {
        'asphalt': 158.0, 'paint': 222.0, 'asphalt_tint': (1.03, 1.0, 0.94), 'mottle': 0.7,
    },
    'grooved': {'asphalt': 122.0, 'asphalt_tint': (1.03, 1.0, 0.95), 'mottle': 0.8},
}
_SURROUNDINGS_LOOKS: dict[str, dict[str, Any]] = {
    'dry': {},
    'grass': {'near_tint': (112.0, 119.0, 80.0), 'far_tint': (98.0, 112.0, 70.0)},
    'sand': {'near_tint': (186.0, 172.0, 140.0), 'far_tint': (178.0, 163.0, 130.0)},
}


def standard_style(runway: Runway, *, crossing: bool = True) -> GroundStyle:
    """Standard style of a runway's surface, its condition and its surroundings.

    Args:
        runway: the runway.
        crossing: whether its crossings are drawn.
    """
    looks = _SURFACE_LOOKS[runway.surface] | _SURROUNDINGS_LOOKS[runway.surroundings]
    style, now = replace(STANDARD, crossing=crossing, **looks), runway.condition
    return replace(
        style, seed=now.seed, asphalt=style.asphalt * now.lightness,
        mottle=style.mottle * now.mottle, rubber_amount=now.rubber, wear=now.wear,
        edge_wear=now.edge_wear, near_tint=_tint(now.ground * np.array(style.near_tint)),
        far_tint=_tint(now.ground * np.array(style.far_tint)),
    )


def with_surface(style: GroundStyle, runway: str, surface: str) -> GroundStyle:
    """The style of another surface beside a runway of this one, in the same light and age.

    Both are of :data:`~taxinet_ros.core.place.runway.SURFACES`.
    """
    of_runway, other = (replace(STANDARD, **_SURFACE_LOOKS[name]) for name in (runway, surface))
    red, green, blue = (
        tint * to / of
        for tint, to, of in zip(
            style.asphalt_tint, other.asphalt_tint, of_runway.asphalt_tint, strict=True
        )
    )
    return replace(
        style, asphalt=style.asphalt * other.asphalt / of_runway.asphalt,
        asphalt_tint=(red, green, blue),
    )


def varied_style(rng: np.random.Generator) -> GroundStyle:
    """Random style, wide enough to contain real images (domain randomization, Tobin et al. 2017).

    Asphalt stays distinguishable from the ground beside it and from the paint.
    """
    asphalt = rng.uniform(85, 160)
    near = rng.uniform(100, 185)
    cast = 1 + rng.uniform(-0.08, 0.08, 3)
    far = near * rng.uniform(0.6, 1.05)
    return GroundStyle(
        seed=int(rng.integers(1, 2**31)),
        asphalt=asphalt,
        rubber=rng.uniform(30, 0.7 * asphalt),
        paint=min(asphalt + rng.uniform(40, 90), 235.0),
        asphalt_tint=_tint(cast * (1.03, 1.0, 0.94)),
        near_tint=_tint(near * cast * (1.06, 1.0, rng.uniform(0.75, 0.95))),
        far_tint=_tint(far * cast * (1.0, 1.0, rng.uniform(0.65, 0.9))),
        mottle=rng.uniform(0.5, 2.5),
        rubber_amount=rng.uniform(0, 1.8),
        rubber_shift_m=rng.normal(0, 0.7),
        wear=rng.uniform(0.3, 2.2),
        edge_wear=rng.uniform(0, 1.5),
        dash_scale=rng.uniform(0.4, 1.3),
        dash_shift_m=rng.uniform(-40, 40),
        without=tuple(kind for kind in _OPTIONAL if rng.uniform() < 0.25),
    )


def _tint(values: np.ndarray) -> Tint:
    red, green, blue = (float(value) for value in values)
    return red, green, blue


_CROSSING_SHADE = 13.0
"""Darkening of the crossing runway's asphalt, in display codes."""
_CROSSING_PAINT_SHADE = 8.0
_LANE_M, _SLAB_M = 3.81, 7.62
_CRACK_BEYOND_M = 1.76
_CRACK = np.array([[0.5], [1.0], [0.5]], np.float32)
_WHEELS_M = -2.3, 0.0, 2.3
_PAINT_TINT = np.array([1.01, 1.0, 0.96], np.float32)


@dataclass(frozen=True, kw_only=True, slots=True)
class Grid:
    """Texel grid of a strip in ``map``: row r starts at x0 + r dx, column c at y0 + c dy."""

    rows: int
    columns: int
    x0_m: float
    dx_m: float
    y0_m: float
    dy_m: float

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows, self.columns

    def row(self, x_m: float) -> float:
        """Continuous row coordinate of ``x_m``; texel r covers r .. r + 1."""
        return (x_m - self.x0_m) / self.dx_m

    def column(self, y_m: float) -> float:
        """Continuous column coordinate of ``y_m``."""
        return (y_m - self.y0_m) / self.dy_m

    def centres(self, rows: slice) -> tuple[Floats, Floats]:
        """Coordinates of the texel centres of some rows: x (n, 1) and y (1, columns) [m]."""
        x = (
            self.x0_m
            + (np.arange(rows.start, rows.stop, dtype=np.float32)[:, None] + 0.5) * self.dx_m
        )
        y = self.y0_m + (np.arange(self.columns, dtype=np.float32)[None, :] + 0.5) * self.dy_m
        return x.astype(np.float32), y.astype(np.float32)


def pavement_colours(style: GroundStyle) -> NDArray[np.uint8]:
    """Lookup table (1, 256, 3) from surface code to RGB; asphalt has a warmer tint than paint."""
    code = np.arange(256, dtype=np.float32)[:, None]
    share = np.clip((code - style.asphalt) / (style.paint - style.asphalt), 0, 1)
    asphalt = np.array(style.asphalt_tint, np.float32)
    tint = asphalt + (_PAINT_TINT - asphalt) * share
    table: NDArray[np.uint8] = np.clip(np.rint(code * tint), 0, 255).astype(np.uint8)[None]
    return table


def runway_surface(grid: Grid, style: GroundStyle, runway: Runway) -> NDArray[np.uint8]:
    """Surface codes of the runway strip, shape ``grid.shape``."""
    value = _asphalt(grid, style, runway)
    painted = _lay_paint(value, grid, style, runway)
    _lay_rubber(value, painted, grid, style, runway)
    for number, crossing in enumerate(crossings(style, runway)):
        _lay_crossing(value, grid, style, crossing, seed=style.seed + 41 + 1000 * number)
    return np.clip(value, 0, 255).astype(np.uint8)


def crossings(style: GroundStyle, runway: Runway) -> tuple[Crossing, ...]:
    """Crossing runways drawn in a style."""
    return runway.crossings if style.crossing else ()


def _asphalt(grid: Grid, style: GroundStyle, runway: Runway) -> Floats:
    """Mottled asphalt with paving lanes, joints and sealed cracks, or concrete slabs."""
    value = white_noise(style.seed + 11, grid.shape)
    value *= np.float32(1.5)
    value += np.float32(style.asphalt)
    for seed, cell_m, amount in (
        (12, (1.6, 0.5), 1.0),
        (13, (9.0, 2.0), 1.8),
        (14, (60.0, 5.0), 3.2),
    ):
        cells = cell_m[0] / grid.dx_m, cell_m[1] / grid.dy_m
        noise = smooth_noise(style.seed + seed, grid.shape, cells)
        value += noise * np.float32(amount * style.mottle)
    rng = np.random.default_rng(style.seed + 15)
    lanes = round(runway.half_width_m / _LANE_M)
    for lane in range(-lanes, lanes + 1):
        column = round(grid.column(lane * _LANE_M))
        if 0 <= column < grid.columns:
            value[:, column : column + 1] -= np.float32(rng.uniform(3, 7) * style.mottle)
    if runway.surface == 'concrete':
        _joint(value, grid, rng, style, runway)
    if runway.surface != 'asphalt':
        return value
    x, reach = 20.0, runway.half_width_m + _CRACK_BEYOND_M
    while x < runway.length_m:
        row = round(grid.row(x))
        left, right = sorted(rng.uniform(-reach, reach, 2))
        columns = slice(round(grid.column(left)), round(grid.column(right)))
        depth = np.float32(rng.uniform(3, 11) * style.mottle)
        if 0 <= row <= grid.rows - 3:
            value[row : row + 3, columns] -= depth * _CRACK
        x += rng.uniform(6, 40)
    return value


def _joint(
    value: Floats, grid: Grid, rng: np.random.Generator, style: GroundStyle, runway: Runway
) -> None:
    """Draw the tar-sealed transverse joints between concrete slabs."""
    edges = (grid.column(side * runway.half_width_m) for side in (-1, 1))
    left, right = (min(max(round(edge), 0), grid.columns) for edge in edges)
    for number in range(int(runway.length_m / _SLAB_M) + 1):
        row = round(grid.row(number * _SLAB_M))
        if 0 <= row < grid.rows:
            value[row, left:right] -= np.float32(rng.uniform(8, 16) * style.mottle)


def _lay_paint(value: Floats, grid: Grid, style: GroundStyle, runway: Runway) -> Floats:
    """Blend the markings over the surface, worn in patches; return their share of each texel."""
    painted = np.zeros(grid.shape, np.float32)
    patchy = smooth_noise(style.seed + 21, grid.shape, (0.9 / grid.dx_m, 0.3 / grid.dy_m))
    patchy += smooth_noise(style.seed + 22, grid.shape, (7.0 / grid.dx_m, 0.8 / grid.dy_m))
    for marking in _markings(style, runway):
        rows, columns, cover = coverage(marking.polygon, grid)
        patch = value[rows, columns]
        wear = style.edge_wear if marking.kind == 'edge' else style.wear
        if wear > 0:
            left = 1 - wear * (0.24 + 0.16 * patchy[rows, columns])
            cover *= np.clip(left, 0.25, 0.95)
        patch += cover * (style.paint - patch)
        painted[rows, columns] = np.maximum(painted[rows, columns], cover)
    return painted


def _markings(style: GroundStyle, runway: Runway) -> list[Marking]:
    """Markings of a style, scaled and shifted along the runway."""

    def moved(marking: Marking) -> Marking:
        if marking.kind == 'edge':
            return marking
        corners = ((x * style.dash_scale + style.dash_shift_m, y) for x, y in marking.polygon)
        return Marking(kind=marking.kind, polygon=tuple(corners))

    painted = markings(runway, crossing=style.crossing)
    return [moved(marking) for marking in painted if marking.kind not in style.without]


def coverage(
    polygon: Polygon, grid: Grid, holes: Sequence[Polygon] = ()
) -> tuple[slice, slice, Floats]:
    """Coverage of texels by a polygon less its holes: rows, columns and the share (0..1)."""
    points = np.array([(grid.column(y), grid.row(x)) for x, y in polygon])
    first = np.maximum(np.floor(points.min(axis=0)).astype(int), 0)
    last = np.minimum(np.ceil(points.max(axis=0)).astype(int), (grid.columns, grid.rows))
    if (last <= first).any():
        return slice(0, 0), slice(0, 0), np.zeros((0, 0), np.float32)
    columns, rows = slice(first[0], last[0]), slice(first[1], last[1])
    fine = np.zeros(((last[1] - first[1]) * 4, (last[0] - first[0]) * 4), np.uint8)
    # fillPoly has integer pixel centres and includes the polygon's edge.
    corners = [np.rint(((points - first) * 4 - 0.5) * 16).astype(np.int32)]
    for hole in holes:
        inner = np.array([(grid.column(y), grid.row(x)) for x, y in hole])
        corners.append(np.rint(((inner - first) * 4 - 0.5) * 16).astype(np.int32))
    cv2.fillPoly(fine, corners, (255,), lineType=cv2.LINE_8, shift=4)
    size = (last[0] - first[0], last[1] - first[1])
    cover = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
    return rows, columns, cover.astype(np.float32) * np.float32(1 / 255)


def _lay_rubber(
    value: Floats, painted: Floats, grid: Grid, style: GroundStyle, runway: Runway
) -> None:
    """Draw tyre rubber: thick in the touchdown zones, thin along the centreline between them."""
    density = np.zeros(grid.shape, np.float32)
    rng = np.random.default_rng(style.seed + 31)
    centres = grid.centres(slice(0, grid.rows))
    streak = partial(_streak, density, grid, centres, rng, style.rubber_shift_m)
    for _ in range(round(640 * style.rubber_amount)):
        start = runway.displaced_m[0] + 40 + rng.beta(1.2, 2.6) * 800
        streak(start=start, length=rng.uniform(15, 120))
    for _ in range(round(460 * style.rubber_amount)):
        start = runway.length_m - runway.displaced_m[1] - 60 - rng.beta(1.2, 2.6) * 800
        streak(start=start, length=rng.uniform(15, 120))
    for _ in range(round(90 * style.rubber_amount)):
        start = rng.uniform(500, max(runway.length_m - 642, 600))
        streak(start=start, length=rng.uniform(80, 300), strength=0.35)
    _smear(density, grid, style, runway)
    patchy = smooth_noise(style.seed + 32, grid.shape, (3.0 / grid.dx_m, 0.4 / grid.dy_m))
    patchy += smooth_noise(style.seed + 33, grid.shape, (14.0 / grid.dx_m, 0.5 / grid.dy_m))
    density *= np.clip(1 + 0.2 * patchy, 0.45, 1.6)
    # Paint is smoother than asphalt and washed by rain, so less rubber stays on it.
    density *= 1 - 0.5 * painted
    # Transmission exp(-density) as a series, because exp differs between processors.
    through = 1 / (1 + density * (1 + density * (1 / 2 + density * (1 / 6 + density / 24))))
    value -= np.float32(style.rubber)
    value *= through
    value += np.float32(style.rubber)


def _streak(
    density: Floats,
    grid: Grid,
    centres: tuple[Floats, Floats],
    rng: np.random.Generator,
    shift_m: float,
    *,
    start: float,
    length: float,
    strength: float = 1.0,
) -> None:
    """Add one tyre's mark: a soft-edged, tapering, slightly slanted line."""
    middle = shift_m + float(rng.normal(_WHEELS_M[rng.integers(3)], 1.9))
    width, slant = float(rng.uniform(0.08, 0.27)), float(rng.normal(0, 0.004))
    darkness = strength * float(rng.uniform(0.2, 1.0))
    first, last = (int(min(max(grid.row(x), 0), grid.rows)) for x in (start, start + length))
    reach = 3 * width + abs(slant) * length
    left, right = (int(min(max(grid.column(middle + s * reach), 0), grid.columns)) for s in (-1, 1))
    if last <= first or right <= left:
        return
    x, y = centres[0][first:last] - start, centres[1][:, left:right]
    along = x / length
    taper = np.clip(along * 8, 0, 1) * np.clip((1 - along) * 1.6, 0, 1)
    offset = (y - middle - slant * x) / width
    bell = np.maximum(1 - offset * offset * (1 / 9), 0)
    bell *= bell
    bell *= bell
    bell *= darkness * taper
    density[first:last, left:right] += bell


def _smear(density: Floats, grid: Grid, style: GroundStyle, runway: Runway) -> None:
    """Add a uniform rubber layer in both touchdown zones and a faint centre trail."""
    x, y = grid.centres(slice(0, grid.rows))
    y = y - np.float32(style.rubber_shift_m)
    near = _carpet(x, 40, 780) + 0.7 * _carpet(runway.length_m - x, 40, 780)
    density += np.float32(0.30 * style.rubber_amount) * near * np.exp(-0.5 * np.square(y / 3.6))
    trail = np.clip((x - 30) / 200, 0, 1) * np.clip((runway.length_m - x) / 200, 0, 1)
    density += np.float32(0.1 * style.rubber_amount) * trail * np.exp(-0.5 * np.square(y / 3.0))


def _carpet(x: Floats, start: float, end: float) -> Floats:
    rise = np.clip((x - start) / 40, 0, 1)
    fall = np.clip((end - x) / (0.6 * (end - start)), 0, 1)
    carpet: Floats = rise * fall
    return carpet


def _lay_crossing(
    value: Floats, grid: Grid, style: GroundStyle, crossing: Crossing, *, seed: int
) -> None:
    """Draw a crossing runway with its paint and rubber over the main runway."""
    half_span_m = max(abs(grid.y0_m), abs(grid.y0_m + grid.columns * grid.dy_m))
    rows = crossing_rows(grid, crossing, half_span_m)
    soft_m = max(grid.dx_m, grid.dy_m)
    surface, share = crossing_surface(*grid.centres(rows), soft_m, style, crossing)
    surface += 3 * white_noise(seed, surface.shape)
    patch = value[rows]
    patch += share * (surface - patch)


def crossing_rows(grid: Grid, crossing: Crossing, half_span_m: float) -> slice:
    """Rows that a crossing runway covers within a distance from the centreline."""
    reach_m = (crossing.clear_half_m + 8) * 1.05
    # An oblique crossing is longer along x; at KMWH's 75 degrees the 5 % suffice.
    reach_m = max(reach_m, (crossing.clear_half_m + 4) / abs(math.sin(crossing.yaw_rad)))
    slant_m = half_span_m / math.tan(abs(crossing.yaw_rad))
    ends = (grid.row(crossing.x_m + side * (reach_m + abs(slant_m))) for side in (-1, 1))
    first, last = (min(max(int(end), 0), grid.rows) for end in ends)
    return slice(first, last)


def crossing_surface(
    x: Floats, y: Floats, soft_m: float, style: GroundStyle, crossing: Crossing
) -> tuple[Floats, Floats]:
    """Surface code of the crossing runway at (x, y) in ``map``, and its share of the texel."""
    cos, sin = math.cos(crossing.yaw_rad), math.sin(crossing.yaw_rad)
    along = (x - crossing.x_m) * cos + y * sin
    across = np.abs(-(x - crossing.x_m) * sin + y * cos)

    def inside(distance: Floats, half: float) -> Floats:
        share: Floats = np.clip((half - distance) / soft_m + 0.5, 0, 1)
        return share

    half = crossing.width_m / 2
    value = style.asphalt - _CROSSING_SHADE + 4 * np.sin(across * 0.83)
    value += 3 * np.sin(along * 0.21 + across * 0.07)
    value += 9 * (1 - inside(across, half + 1))
    for distance, width, darkness in ((3.1, 1.4, 34.0), (9.0, 3.0, 14.0), (18.0, 2.0, 8.0)):
        value -= darkness * np.exp(-0.5 * np.square((across - distance) / width))
    dash = inside(np.abs(np.mod(along, 61.0) - 30.5), 18.3)
    paint = np.maximum(inside(np.abs(across - half + 1.4), 0.46), inside(across, 0.46) * dash * 0.8)
    value += paint * (style.paint - _CROSSING_PAINT_SHADE - value)
    return value.astype(np.float32), inside(across, crossing.clear_half_m)
