"""Runway 04 of Grant County airport (KMWH): its place on the Earth, its size and its paint.

Coordinates are ``map`` coordinates in metres (see :mod:`taxinet_ros.core.types`). End points after
the paper's published code; width after the published pictures (100 ft, edge stripes centred at
14.7 m); paint after FAA AC 150/5340-1, with the widths that the circular gives for 150 ft runways
scaled to 100 ft. A wider runway crosses near 1,450 m and, as the circular demands of the lesser
runway, interrupts this one's centreline and edge stripes there (paper: about 1,350-1,500 m).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

Polygon = tuple[tuple[float, float], ...]

FOOT_M = 0.3048


@dataclass(frozen=True, kw_only=True, slots=True)
class Runway:
    """Where a runway lies and how large it is, for whoever needs a place: aircraft, camera, sun.

    Attributes:
        threshold_deg: geodetic latitude and longitude of the origin of ``map`` [deg].
        end_deg: the same of the far end of the centreline, on the x axis [deg].
        elevation_m: height of the ground above the ellipsoid [m], the same everywhere.
        bearing_rad: true bearing of the x axis [rad], clockwise from north.
        length_m, width_m: of the pavement between its ends and edges [m].
        utc_offset_h: local standard time less UTC [h].
    """

    threshold_deg: tuple[float, float]
    end_deg: tuple[float, float]
    elevation_m: float
    bearing_rad: float
    length_m: float
    width_m: float
    utc_offset_h: float


KMWH_04 = Runway(
    threshold_deg=(47.196736, -119.332917), end_deg=(47.212778, -119.300297), elevation_m=354.0,
    bearing_rad=math.radians(54.09), length_m=3042.0, width_m=100 * FOOT_M, utc_offset_h=-8.0,
)
"""End points of the paper's simulator scenes. The ground is flat at the height of the threshold;
the real runway climbs by 0.2 %."""

LENGTH_M, WIDTH_M = KMWH_04.length_m, KMWH_04.width_m
HALF_WIDTH_M = WIDTH_M / 2
EDGE_STRIPE_Y_M = 14.7
"""Distance of the edge stripes' middle from the centreline."""

STRIPE_WIDTH_M = 3 * FOOT_M
"""Width of the centreline and edge stripes (36 in, precision runway)."""

CENTRELINE_STRIPE_M, CENTRELINE_GAP_M = 120 * FOOT_M, 80 * FOOT_M

CROSSING_X_M = 1445.0
"""Where the middle of the crossing runway meets the centreline."""

CROSSING_YAW_RAD = math.radians(-75.0)
"""Direction of the crossing runway's own axis, counter-clockwise from the x axis."""

CROSSING_WIDTH_M = 200 * FOOT_M
CROSSING_CLEAR_HALF_M = 68.0
"""Nothing of ours is painted within this distance of the crossing runway's axis (across it)."""

_SCALE = 2 / 3  # 100 ft over 150 ft
_THRESHOLD_START_M, _THRESHOLD_LENGTH_M = 20 * FOOT_M, 150 * FOOT_M
_THRESHOLD_STRIPES, _THRESHOLD_WIDTH_M = 8, 5.75 * FOOT_M
_DESIGNATION_START_M = _THRESHOLD_START_M + _THRESHOLD_LENGTH_M + 40 * FOOT_M
_DIGIT_HEIGHT_M, _DIGIT_WIDTH_M, _DIGIT_STROKE_M = 60 * FOOT_M, 17 * FOOT_M, 4.5 * FOOT_M
_DIGIT_GAP_M = 10 * FOOT_M
CENTRELINE_START_M = _DESIGNATION_START_M + _DIGIT_HEIGHT_M + 40 * FOOT_M
_AIMING_START_M, _AIMING_LENGTH_M = 1020 * FOOT_M, 150 * FOOT_M
_AIMING_WIDTH_M, _AIMING_INNER_M = 30 * FOOT_M * _SCALE, 36 * FOOT_M * _SCALE
_ZONE_LENGTH_M, _ZONE_WIDTH_M, _ZONE_GAP_M = 75 * FOOT_M, 6 * FOOT_M * _SCALE, 5 * FOOT_M * _SCALE
_ZONE_BARS = ((500, 3), (1500, 2), (2000, 2), (2500, 1), (3000, 1))


@dataclass(frozen=True, kw_only=True, slots=True)
class Marking:
    """One painted patch.

    Attributes:
        kind: ``threshold``, ``designation``, ``centreline``, ``aiming``, ``touchdown`` or ``edge``.
        polygon: corners (x, y) in ``map`` [m], convex or not, without crossing edges.
    """

    kind: str
    polygon: Polygon


def _rectangle(kind: str, x0: float, x1: float, y0: float, y1: float) -> Marking:
    return Marking(kind=kind, polygon=((x0, y0), (x1, y0), (x1, y1), (x0, y1)))


def _threshold() -> list[Marking]:
    """Eight stripes, four a side, with a double gap at the centreline."""
    x1 = _THRESHOLD_START_M + _THRESHOLD_LENGTH_M
    inner = [_THRESHOLD_WIDTH_M * (1 + 2 * k) for k in range(_THRESHOLD_STRIPES // 2)]
    return [
        _rectangle('threshold', _THRESHOLD_START_M, x1, side * y, side * (y + _THRESHOLD_WIDTH_M))
        for side in (1, -1)
        for y in inner
    ]


# Digits as strokes in a unit box, (up, right) from the lower left corner: the reader comes from
# below. Corners are cut as on the ground, where they are drawn without curves.
_W, _S, _H = _DIGIT_WIDTH_M, _DIGIT_STROKE_M, _DIGIT_HEIGHT_M
_DIGITS: dict[str, tuple[Polygon, ...]] = {
    '0': (
        ((0, _S), (_H, _S), (_H, 0.9 * _S), (_H - _S, 0), (_S, 0), (0, 0.9 * _S)),
        (
            (0, _W - _S),
            (_H, _W - _S),
            (_H, _W - 0.9 * _S),
            (_H - _S, _W),
            (_S, _W),
            (0, _W - 0.9 * _S),
        ),
        ((0, _S), (0, _W - _S), (_S, _W - _S), (_S, _S)),
        ((_H - _S, _S), (_H - _S, _W - _S), (_H, _W - _S), (_H, _S)),
    ),
    '2': (
        ((0, 0), (_S, 0), (_S, _W), (0, _W)),
        ((_S, 0), (2 * _S, 0), (_H * 0.62, _W), (_H * 0.62 - 1.4 * _S, _W)),
        ((_H * 0.62 - _S, _W - _S), (_H - _S, _W - _S), (_H - _S, _W), (_H * 0.62 - _S, _W)),
        ((_H - _S, 0), (_H, 0.6 * _S), (_H, _W - 0.6 * _S), (_H - _S, _W)),
        ((_H * 0.72, 0), (_H - _S, 0), (_H - _S, _S), (_H * 0.72, _S)),
    ),
    '4': (
        ((0, _W - 1.8 * _S), (_H, _W - 1.8 * _S), (_H, _W - 0.8 * _S), (0, _W - 0.8 * _S)),
        ((_H * 0.28, 0), (_H * 0.28 + _S, 0), (_H * 0.28 + _S, _W), (_H * 0.28, _W)),
        (
            (_H * 0.28 + _S, 0),
            (_H * 0.28 + 2 * _S, 0),
            (_H, _W - 1.8 * _S),
            (_H - 1.4 * _S, _W - 1.8 * _S),
        ),
    ),
}


def _designation(text: str) -> list[Marking]:
    total = len(text) * _DIGIT_WIDTH_M + (len(text) - 1) * _DIGIT_GAP_M
    markings = []
    for place, digit in enumerate(text):
        left = total / 2 - place * (_DIGIT_WIDTH_M + _DIGIT_GAP_M)
        for stroke in _DIGITS[digit]:
            polygon = tuple((_DESIGNATION_START_M + up, left - right) for up, right in stroke)
            markings.append(Marking(kind='designation', polygon=polygon))
    return markings


def _touchdown() -> list[Marking]:
    """Aiming point and touchdown-zone bars, both sides of the centreline."""
    markings = []
    for side in (1, -1):
        y = side * _AIMING_INNER_M
        x1 = _AIMING_START_M + _AIMING_LENGTH_M
        markings.append(_rectangle('aiming', _AIMING_START_M, x1, y, y + side * _AIMING_WIDTH_M))
        for feet, count in _ZONE_BARS:
            for bar in range(count):
                y = side * (_AIMING_INNER_M + bar * (_ZONE_WIDTH_M + _ZONE_GAP_M))
                x = feet * FOOT_M
                markings.append(
                    _rectangle('touchdown', x, x + _ZONE_LENGTH_M, y, y + side * _ZONE_WIDTH_M)
                )
    return markings


def _turned_round(markings: list[Marking]) -> list[Marking]:
    """The same paint seen from the other end."""
    return [
        Marking(kind=m.kind, polygon=tuple((LENGTH_M - x, -y) for x, y in m.polygon))
        for m in markings
    ]


def crossing_clear_x(y_m: float) -> tuple[float, float]:
    """Interval of x [m] at lateral position ``y_m`` in which the crossing interrupts our paint."""
    sin, cos = math.sin(CROSSING_YAW_RAD), math.cos(CROSSING_YAW_RAD)
    middle = CROSSING_X_M + y_m * cos / sin
    reach = CROSSING_CLEAR_HALF_M / abs(sin)
    return middle - reach, middle + reach


def _stripe(
    kind: str, x0: float, x1: float, y0: float, y1: float, *, crossing: bool
) -> list[Marking]:
    """A stripe along the runway, with the crossing's share cut out where there is a crossing."""
    if not crossing:
        return [_rectangle(kind, x0, x1, y0, y1)]
    clear0, clear1 = crossing_clear_x((y0 + y1) / 2)
    pieces = ((x0, min(x1, clear0)), (max(x0, clear1), x1))
    return [_rectangle(kind, a, b, y0, y1) for a, b in pieces if b > a]


def _centreline(*, crossing: bool) -> list[Marking]:
    half, markings = STRIPE_WIDTH_M / 2, []
    start, end = CENTRELINE_START_M, LENGTH_M - CENTRELINE_START_M
    while start < end:
        stop = min(start + CENTRELINE_STRIPE_M, end)
        markings += _stripe('centreline', start, stop, -half, half, crossing=crossing)
        start += CENTRELINE_STRIPE_M + CENTRELINE_GAP_M
    return markings


def _edges(*, crossing: bool) -> list[Marking]:
    half = STRIPE_WIDTH_M / 2
    return [
        marking
        for middle in (EDGE_STRIPE_Y_M, -EDGE_STRIPE_Y_M)
        for marking in _stripe(
            'edge', 0.0, LENGTH_M, middle - half, middle + half, crossing=crossing
        )
    ]


@cache
def markings(*, crossing: bool = True) -> tuple[Marking, ...]:
    """Everything painted on runway 04/22, in no particular order.

    Args:
        crossing: whether there is a crossing that interrupts centreline and edge stripes.
    """
    approach = [*_threshold(), *_touchdown()]
    ends = [*approach, *_designation('04')]
    other_end = _turned_round([*approach, *_designation('22')])
    stripes = (*_centreline(crossing=crossing), *_edges(crossing=crossing))
    return (*ends, *other_end, *stripes)
