"""Runway markings according to FAA AC 150/5340-1, by category and runway width.

The circular gives dimensions for runways 150 ft wide; on narrower ones, lateral positions and
widths of markings beside the centreline are scaled in proportion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.types import FOOT_M

Polygon = tuple[tuple[float, float], ...]

CENTRELINE_STRIPE_M, CENTRELINE_GAP_M = 120 * FOOT_M, 80 * FOOT_M
EDGE_STRIPE_WIDTH_M = 3 * FOOT_M
_CENTRELINE_WIDTH_M = {
    'visual': FOOT_M, 'nonprecision': 1.5 * FOOT_M, 'precision': 3 * FOOT_M,
}
"""Minimum widths: 12, 18 and 36 in."""

_EDGE_INSET_M = 0.54
"""Distance of the edge stripe's middle from the pavement's edge, as in the images of KMWH."""

_THRESHOLD_START_M, _THRESHOLD_LENGTH_M = 20 * FOOT_M, 150 * FOOT_M
_THRESHOLD_STRIPE_M = 5.75 * FOOT_M
_THRESHOLD_STRIPES = ((60, 4), (75, 6), (100, 8), (150, 12), (200, 16))
"""Number of stripes by the runway's width [ft]."""
_DIGIT_HEIGHT_M, _DIGIT_WIDTH_M, _DIGIT_STROKE_M = 60 * FOOT_M, 17 * FOOT_M, 4.5 * FOOT_M
_DIGIT_GAP_M, _LETTER_GAP_M = 10 * FOOT_M, 20 * FOOT_M
_AIMING_START_M, _AIMING_LENGTH_M = 1020 * FOOT_M, 150 * FOOT_M
_AIMING_WIDTH_M, _AIMING_INNER_M = 30 * FOOT_M, 36 * FOOT_M
_AIMING_LEAST_RUNWAY_M = 4200 * FOOT_M
_ZONE_LENGTH_M, _ZONE_WIDTH_M, _ZONE_GAP_M = 75 * FOOT_M, 6 * FOOT_M, 5 * FOOT_M
_ZONE_BARS = ((500, 3), (1500, 2), (2000, 2), (2500, 1), (3000, 1))
_ZONE_FREE_M = 900 * FOOT_M
"""Distance from the middle of the runway without touchdown-zone bars [m]."""
_BAR_LENGTH_M = 10 * FOOT_M
_ARROW_SPACING_M, _ARROW_LENGTH_M, _ARROW_HEAD_M = 80 * FOOT_M, 120 * FOOT_M, 45 * FOOT_M
_ARROW_HALF_M = 7.5 * FOOT_M


@dataclass(frozen=True, kw_only=True, slots=True)
class Marking:
    """One painted polygon.

    Attributes:
        kind: ``threshold``, ``designation``, ``centreline``, ``aiming``, ``touchdown`` or ``edge``.
        polygon: corners (x, y) in ``map`` [m] of a simple polygon, convex or not.
    """

    kind: str
    polygon: Polygon


@lru_cache(maxsize=16)
def markings(runway: Runway, *, crossing: bool = True) -> tuple[Marking, ...]:
    """All markings of a runway, in no particular order.

    Args:
        runway: the runway.
        crossing: whether crossing runways exist and interrupt the markings.
    """
    near, far = (_end(runway, end) for end in (0, 1))
    other_end = [
        Marking(kind=m.kind, polygon=tuple((runway.length_m - x, -y) for x, y in m.polygon))
        for m in far
    ]
    ends = [m for m in (*near, *other_end) if not crossing or _is_clear(m, runway)]
    return (
        *ends,
        *_centreline(runway, crossing=crossing), *_edges(runway, crossing=crossing),
    )


def _is_clear(marking: Marking, runway: Runway) -> bool:
    """Whether a marking is clear of all crossing runways."""
    xs = [x for x, _ in marking.polygon]
    y_m = marking.polygon[0][1]
    gaps = (one.clear_x(y_m) for one in runway.crossings)
    return all(max(xs) <= first or min(xs) >= last for first, last in gaps)


def edge_stripe_y_m(runway: Runway) -> float:
    """Distance of the edge stripes' middle from the centreline [m]."""
    return round(runway.half_width_m - _EDGE_INSET_M, 9)


def centreline_start_m(runway: Runway, end: int = 0) -> float:
    """Start of the centreline's first stripe, from end 0 or 1 [m]."""
    rows = 2 if runway.designations[end][-1].isalpha() else 1
    text_m = rows * _DIGIT_HEIGHT_M + (rows - 1) * _LETTER_GAP_M
    return _designation_start_m(runway, end) + text_m + 40 * FOOT_M


def _designation_start_m(runway: Runway, end: int) -> float:
    start = runway.displaced_m[end] + _THRESHOLD_START_M
    # Without threshold stripes, the designation is in their place.
    return start if runway.category == 'visual' else start + _THRESHOLD_LENGTH_M + 40 * FOOT_M


def _rectangle(kind: str, x0: float, x1: float, y0: float, y1: float) -> Marking:
    return Marking(kind=kind, polygon=((x0, y0), (x1, y0), (x1, y1), (x0, y1)))


def _end(runway: Runway, end: int) -> list[Marking]:
    """Markings at one end, in coordinates from that end."""
    found: list[Marking] = []
    if runway.category != 'visual':
        found += _threshold(runway, end)
        if runway.length_m >= _AIMING_LEAST_RUNWAY_M:
            found += _touchdown(runway, end)
    if runway.displaced_m[end] > 0:
        found += _displaced(runway, end)
    return [*found, *_designation(runway, end)]


def _threshold(runway: Runway, end: int) -> list[Marking]:
    """Threshold stripes, half of them on each side, with a double gap at the centreline."""
    width_ft = runway.width_m / FOOT_M
    # Metric widths map to the next size in feet: 45 m counts as 150 ft, 60 m as 200 ft.
    count = max(
        (number for least_ft, number in _THRESHOLD_STRIPES if width_ft >= 0.97 * least_ft),
        default=_THRESHOLD_STRIPES[0][1],
    )
    x0 = runway.displaced_m[end] + _THRESHOLD_START_M
    x1 = x0 + _THRESHOLD_LENGTH_M
    inner = [_THRESHOLD_STRIPE_M * (1 + 2 * k) for k in range(count // 2)]
    return [
        _rectangle('threshold', x0, x1, side * y, side * (y + _THRESHOLD_STRIPE_M))
        for side in (1, -1)
        for y in inner
    ]


def _displaced(runway: Runway, end: int) -> list[Marking]:
    """Bar of a displaced threshold, and the arrows along the centreline before it."""
    bar, half = runway.displaced_m[end], runway.half_width_m
    found = [_rectangle('threshold', bar - _BAR_LENGTH_M, bar, -half, half)]
    tip, thin = bar - _BAR_LENGTH_M - 15 * FOOT_M, _CENTRELINE_WIDTH_M['nonprecision'] / 2
    while tip - _ARROW_LENGTH_M > 0:
        neck = tip - _ARROW_HEAD_M
        found.append(Marking(kind='threshold', polygon=(
            (tip, 0.0), (neck, _ARROW_HALF_M), (neck, thin), (tip - _ARROW_LENGTH_M, thin),
            (tip - _ARROW_LENGTH_M, -thin), (neck, -thin), (neck, -_ARROW_HALF_M),
        )))
        tip -= _ARROW_LENGTH_M + _ARROW_SPACING_M
    return found


# Digits as strokes in (up, right) coordinates [m] from the lower left corner, as read by a landing
# pilot. Corners are cut, because painted digits have no curves.
_W, _S, _H = _DIGIT_WIDTH_M, _DIGIT_STROKE_M, _DIGIT_HEIGHT_M
_M = (_H + _S) / 2  # upper side of the bar at half height


def _box(up0: float, up1: float, right0: float, right1: float) -> Polygon:
    return (up0, right0), (up1, right0), (up1, right1), (up0, right1)


_TOP, _MIDDLE, _BOTTOM = (_box(up - _S, up, _S, _W - _S) for up in (_H, _M, _S))
_LEFT, _RIGHT = _box(0, _H, 0, _S), _box(0, _H, _W - _S, _W)
_UPPER_LEFT, _UPPER_RIGHT = (_box(_M - _S, _H, r, r + _S) for r in (0, _W - _S))
_LOWER_RIGHT = _box(0, _M, _W - _S, _W)
_STROKES: dict[str, tuple[Polygon, ...]] = {
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
    '1': (
        _box(0, _H, (_W - _S) / 2, (_W + _S) / 2),
        (
            (_H - _S, (_W - _S) / 2), (_H - 2 * _S, (_W - _S) / 2),
            (_H - 3.2 * _S, _W / 2 - 1.6 * _S), (_H - 2.2 * _S, _W / 2 - 1.6 * _S),
        ),
    ),
    '3': (_TOP, _MIDDLE, _BOTTOM, _RIGHT, _box(_H - _S, _H, 0, _S), _box(0, _S, 0, _S)),
    '5': (
        _TOP, _MIDDLE, _BOTTOM, _UPPER_LEFT, _LOWER_RIGHT, _box(_H - _S, _H, _W - _S, _W),
        _box(0, _S, 0, _S),
    ),
    '6': (_TOP, _MIDDLE, _BOTTOM, _LEFT, _LOWER_RIGHT, _box(_H - _S, _H, _W - _S, _W)),
    '7': (
        _box(_H - _S, _H, 0, _W),
        ((_H - _S, _W - _S), (_H - _S, _W), (0, 0.45 * _W), (0, 0.45 * _W - _S)),
    ),
    '8': (_TOP, _MIDDLE, _BOTTOM, _LEFT, _RIGHT),
    '9': (_TOP, _MIDDLE, _BOTTOM, _UPPER_LEFT, _RIGHT, _box(0, _S, 0, _S)),
    'L': (_LEFT, _box(0, _S, _S, _W)),
    'C': (_TOP, _BOTTOM, _LEFT, _box(_H - _S, _H, _W - _S, _W), _box(0, _S, _W - _S, _W)),
    'R': (
        _TOP, _MIDDLE, _LEFT, _UPPER_RIGHT,
        ((_M - _S, _W - 2 * _S), (_M - _S, _W - _S), (0, _W), (0, _W - _S)),
    ),
}


def _designation(runway: Runway, end: int) -> list[Marking]:
    """Runway number, preceded by the letter of a parallel runway."""
    text, start = runway.designations[end], _designation_start_m(runway, end)
    number, letter = text[:2], text[2:]
    markings = []
    for row, word in enumerate(filter(None, (letter, number))):
        total = len(word) * _DIGIT_WIDTH_M + (len(word) - 1) * _DIGIT_GAP_M
        up0 = start + row * (_DIGIT_HEIGHT_M + _LETTER_GAP_M)
        for place, digit in enumerate(word):
            left = total / 2 - place * (_DIGIT_WIDTH_M + _DIGIT_GAP_M)
            for stroke in _STROKES[digit]:
                polygon = tuple((up0 + up, left - right) for up, right in stroke)
                markings.append(Marking(kind='designation', polygon=polygon))
    return markings


def _touchdown(runway: Runway, end: int) -> list[Marking]:
    """Aiming point and, on a precision runway, touchdown-zone bars, on both sides."""
    scale = min(round(runway.width_m / FOOT_M) / 150, 1.0)
    start, inner = runway.displaced_m[end], _AIMING_INNER_M * scale
    width, gap = _ZONE_WIDTH_M * scale, _ZONE_GAP_M * scale
    last = runway.length_m / 2 - _ZONE_FREE_M - _ZONE_LENGTH_M
    bars = _ZONE_BARS if runway.category == 'precision' else ()
    markings = []
    for side in (1, -1):
        y, x = side * inner, start + _AIMING_START_M
        outer = y + side * (_AIMING_WIDTH_M * scale)
        markings.append(_rectangle('aiming', x, x + _AIMING_LENGTH_M, y, outer))
        for feet, count in bars:
            x = start + feet * FOOT_M
            for bar in range(count if x <= last else 0):
                y = side * (inner + bar * (width + gap))
                markings.append(
                    _rectangle('touchdown', x, x + _ZONE_LENGTH_M, y, y + side * width)
                )
    return markings


def _stripe(
    kind: str, x0: float, x1: float, y0: float, y1: float, gaps: list[tuple[float, float]]
) -> list[Marking]:
    """A stripe along the runway without the gaps, which are ordered by x."""
    pieces, start = [], x0
    for gap0, gap1 in gaps:
        pieces.append((start, min(x1, gap0)))
        start = max(start, gap1)
    return [_rectangle(kind, a, b, y0, y1) for a, b in (*pieces, (start, x1)) if b > a]


def _gaps(runway: Runway, y_m: float, *, crossing: bool) -> list[tuple[float, float]]:
    return [one.clear_x(y_m) for one in runway.crossings] if crossing else []


def _centreline(runway: Runway, *, crossing: bool) -> list[Marking]:
    half, markings = _CENTRELINE_WIDTH_M[runway.category] / 2, []
    gaps = _gaps(runway, 0.0, crossing=crossing)
    start, end = centreline_start_m(runway), runway.length_m - centreline_start_m(runway, 1)
    while start < end:
        stop = min(start + CENTRELINE_STRIPE_M, end)
        markings += _stripe('centreline', start, stop, -half, half, gaps)
        start += CENTRELINE_STRIPE_M + CENTRELINE_GAP_M
    return markings


def _edges(runway: Runway, *, crossing: bool) -> list[Marking]:
    if not runway.edge_stripes:
        return []
    half, found = EDGE_STRIPE_WIDTH_M / 2, []
    for side in (1, -1):
        middle = side * edge_stripe_y_m(runway)
        y0, y1 = middle - half, middle + half
        gaps = _gaps(runway, (y0 + y1) / 2, crossing=crossing)
        found += _stripe('edge', 0.0, runway.length_m, y0, y1, gaps)
    return found
