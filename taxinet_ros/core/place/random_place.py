"""A world of runways: places that are not real but could be, each from a whole number.

``random:17`` is a place like any other, wherever one is named; the same number gives the same one,
to the byte. What a runway may be is taken from ICAO Annex 14 (I, 3.1: width by code number and
class of approach; 5.2: markings) and from FAA AC 150/5340-1 and 150/5300-13 (paint, 60 to 200 ft).

**Splits.** A network that is to steer at places that it has never seen is trained on some places,
its epoch is chosen on others, its recipe on third ones, and it is judged once, on the last. These
ranges of numbers do not overlap and do not change; nothing is tuned on ``test``:

============== ================== =============================================================
``train``      0 to 599           pictures to learn from
``validation`` 10,000 to 10,059   pictures that choose the epoch of a training
``selection``  20,000 to 20,039   runs that choose between recipes, architectures, views
``test``       90,000 to 90,099   runs that judge the chosen network, after all choices
============== ================== =============================================================

Real places, shipped ones and those of an ``apt.dat``, are in none of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.place_file import STEEPEST_DEG, make_place
from taxinet_ros.errors import UsageError

PREFIX = 'random:'
SPLITS: Mapping[str, range] = {
    'train': range(600),
    'validation': range(10_000, 10_060),
    'selection': range(20_000, 20_040),
    'test': range(90_000, 90_100),
}
"""Numbers of the places of each split; see the module."""

_LARGEST = 2**31 - 1
_EARTH_M = 6_371_000.0
_CODES = (
    # Share; lengths [m]; widths [m] with their shares; shares of visual, nonprecision, precision.
    (0.15, (720, 800), {18.0: 4, 18.3: 2, 23.0: 2, 30.0: 1}, (7, 3, 0)),
    (0.25, (800, 1200), {18.3: 1, 23.0: 3, 22.9: 2, 30.0: 3, 30.5: 1}, (4, 5, 1)),
    (0.25, (1200, 1800), {23.0: 1, 30.0: 4, 30.5: 2, 45.0: 2}, (1, 5, 4)),
    (0.35, (1800, 3600), {30.0: 1, 30.5: 1, 45.0: 5, 45.7: 3, 60.0: 2}, (0, 3, 7)),
)
"""Of code numbers 1 to 4 (Annex 14, table 1-1). Widths in whole feet beside those in metres."""
_LEAST_PRECISION_M = 30.0
"""Width of a precision approach runway (Annex 14, 3.1.10)."""
_WIDE_M = 60.0
"""Width of a runway with its shoulders, where there are some (Annex 14, 3.2.3)."""
_CLEAR_OF_ENDS_M, _CLEAR_OF_OTHERS_M = 150.0, 60.0
_SURFACES = {'asphalt': 5, 'concrete': 3, 'grooved': 2}
_SURROUNDINGS = {'grass': 5, 'dry': 4, 'sand': 1}
_SUFFIXES = {'': 8, 'L': 1, 'R': 1, 'C': 0.3}
_OPPOSITE = {'': '', 'L': 'R', 'R': 'L', 'C': 'C'}
_TAXIWAY_LINE = 1
"""X-Plane's type of a taxiway's centreline."""


def random_place(number: int) -> Place:
    """The place of a number; valid by construction.

    Raises:
        UsageError: the number is out of range.
    """
    if not 0 <= number <= _LARGEST:
        raise UsageError(f'place {PREFIX}{number}: the number is outside 0..{_LARGEST}')
    return make_place(_document(number), Path(f'{PREFIX}{number}'))


def _document(number: int) -> dict[str, Any]:
    """Its content, as in a place file."""
    rng = np.random.default_rng([number, 1])
    code = _CODES[_pick(rng, [share for share, *_ in _CODES])]
    _, lengths_m, widths, categories = code
    length_m = rng.uniform(*lengths_m)
    width_m = _one_of(rng, widths)
    category = ('visual', 'nonprecision', 'precision')[_pick(rng, categories)]
    if category == 'precision' and width_m < _LEAST_PRECISION_M:
        category = 'nonprecision'
    bearing_deg = round(rng.uniform(0, 360), 2)
    near = round(rng.uniform(-58, 68), 6), round(rng.uniform(-178, 178), 6)
    far = _beyond(near, length_m, bearing_deg)
    crossings = _crossings(rng, length_m)
    exits = _exits(rng, length_m, width_m, crossings)
    found: dict[str, Any] = {
        'name': f'random_{number}',
        'title': f'place {number} of a random world',
        'time_zone': f'UTC{"+" if near[1] >= 0 else "-"}{abs(round(near[1] / 15)):02d}:00',
        'runway': {
            'ends': _ends(rng, near, far, bearing_deg, length_m),
            'width_m': width_m,
            'elevation_m': round(float(rng.gamma(1.2, 250.0)) % 3000, 1),
            'category': category,
            'edge_stripes': category == 'precision' or bool(rng.uniform() < 0.45),
            'surface': _one_of(rng, _SURFACES),
            'surroundings': _one_of(rng, _SURROUNDINGS),
            'shoulder_m': _shoulder_m(rng, width_m),
            'condition': _condition(rng, number),
        },
    }
    if crossings:
        found['runway']['crossings'] = crossings
    if exits:
        beside = _one_of(rng, {'asphalt': 2, 'concrete': 1})
        found['pavements'] = [{'surface': beside, 'outline_m': outline} for outline, _ in exits]
        found['lines'] = [{'style': _TAXIWAY_LINE, 'points_m': line} for _, line in exits]
    return found


def _pick(rng: np.random.Generator, shares: Any) -> int:
    weights = np.asarray(list(shares), float)
    return int(np.searchsorted(np.cumsum(weights), rng.uniform(0, weights.sum()), 'right'))


def _one_of(rng: np.random.Generator, shares: Mapping[Any, float]) -> Any:
    return list(shares)[_pick(rng, shares.values())]


def _beyond(near: tuple[float, float], length_m: float, bearing_deg: float) -> tuple[float, float]:
    """The other end, on a sphere; the place computes length and bearing anew, on the ellipsoid."""
    bearing = math.radians(bearing_deg)
    north, east = length_m * math.cos(bearing), length_m * math.sin(bearing)
    middle = math.radians(near[0] + math.degrees(north / _EARTH_M) / 2)
    return (
        round(near[0] + math.degrees(north / _EARTH_M), 7),
        round(near[1] + math.degrees(east / (_EARTH_M * math.cos(middle))), 7),
    )


def _ends(
    rng: np.random.Generator, near: tuple[float, float], far: tuple[float, float],
    bearing_deg: float, length_m: float,
) -> list[dict[str, Any]]:
    """Designations by the magnetic bearing (AC 150/5340-1, 2.3), and displaced thresholds."""
    magnetic_deg = bearing_deg + rng.uniform(-20, 20)
    number = round(magnetic_deg / 10) % 36 or 36
    suffix = _one_of(rng, _SUFFIXES)
    ends = []
    for position, digits, letter in (
        (near, number, suffix), (far, (number + 17) % 36 + 1, _OPPOSITE[suffix])
    ):
        displaced = bool(rng.uniform() < 0.25)
        most_m = min(450.0, 0.2 * length_m)
        ends.append({
            'designation': f'{digits:02d}{letter}',
            'latitude_deg': position[0],
            'longitude_deg': position[1],
            'displaced_m': round(rng.uniform(40, most_m), 1) if displaced else 0.0,
        })
    return ends


def _shoulder_m(rng: np.random.Generator, width_m: float) -> float:
    """Few narrow runways have paved shoulders; most wide ones do."""
    if rng.uniform() > (0.15 if width_m < 45 else 0.6):
        return 0.0
    return round(rng.uniform(1.5, max((_WIDE_M - width_m) / 2, 5.0) if width_m >= 45 else 5.0), 1)


def _condition(rng: np.random.Generator, number: int) -> dict[str, Any]:
    """From new to worn out, the paint alike."""
    age = rng.uniform()

    def aged(new: float, old: float, spread: float) -> float:
        return round(max(0.0, new + (old - new) * age + rng.normal(0, spread)), 3)

    return {
        'lightness': round(float(np.clip(aged(0.86, 1.1, 0.06), 0.75, 1.2)), 3),
        'mottle': min(aged(0.4, 2.2, 0.3), 4.0),
        'rubber': min(round(float(rng.gamma(1.5, 0.6)), 3), 2.5),
        'wear': min(aged(0.2, 2.0, 0.25), 3.0),
        'edge_wear': min(aged(0.0, 1.6, 0.25), 3.0),
        'ground': round(rng.uniform(0.75, 1.2), 3),
        'seed': number + 1,
    }


def _crossings(rng: np.random.Generator, length_m: float) -> list[dict[str, Any]]:
    """None, one or two, clear of the ends and of each other."""
    found: list[dict[str, Any]] = []
    taken: list[tuple[float, float]] = []
    for _ in range(_pick(rng, (6, 3, 1))):
        angle_deg = rng.uniform(STEEPEST_DEG + 5, 90) * rng.choice((-1, 1))
        width_m = _one_of(rng, {23.0: 2, 30.0: 4, 45.0: 4})
        clear_half_m = round(width_m / 2 + rng.uniform(0, 30), 1)
        x_m = round(rng.uniform(_CLEAR_OF_ENDS_M, length_m - _CLEAR_OF_ENDS_M), 1)
        reach_m = clear_half_m / abs(math.sin(math.radians(angle_deg))) + _CLEAR_OF_OTHERS_M
        if all(x_m + reach_m < low or x_m - reach_m > high for low, high in taken):
            taken.append((x_m - reach_m, x_m + reach_m))
            fillet_m = rng.uniform(5, 60)
            paved_m = reach_m - _CLEAR_OF_OTHERS_M + fillet_m
            found.append({
                'x_m': x_m, 'yaw_deg': round(float(angle_deg), 1), 'width_m': width_m,
                'clear_half_m': clear_half_m,
                'paved_m': [round(x_m - paved_m, 1), round(x_m + paved_m, 1)],
            })
    return found


def _exits(
    rng: np.random.Generator, length_m: float, width_m: float, crossings: list[dict[str, Any]]
) -> list[tuple[list[list[float]], list[list[float]]]]:
    """Taxiways that leave the runway, at a right angle or faster: outline and centreline."""
    found = []
    for _ in range(int(rng.integers(0, 6))):
        x_m = rng.uniform(60, length_m - 60)
        side, half_m = float(rng.choice((-1, 1))), rng.uniform(5.25, 12.5)
        turn = math.radians(90 if rng.uniform() < 0.7 else rng.uniform(30, 60))
        flare_m, reach_m = rng.uniform(5, 30), rng.uniform(60, 140)
        across_m = half_m / math.sin(turn)
        # Distance along the runway from the middle of the exit, and from the runway's edge.
        outline = (
            (-across_m - flare_m, 0.0), (-across_m, flare_m), (-across_m, reach_m),
            (across_m, reach_m), (across_m, flare_m), (across_m + flare_m, 0.0),
        )
        placed = [
            [
                [
                    round(x_m + along_m + aside_m / math.tan(turn), 1),
                    round(side * (width_m / 2 + aside_m), 1),
                ]
                for along_m, aside_m in corners
            ]
            for corners in (outline, ((0.0, -1.0), (0.0, reach_m)))
        ]
        if all(abs(x_m - one['x_m']) > one['clear_half_m'] + 150 for one in crossings):
            found.append((placed[0], placed[1]))
    return found
