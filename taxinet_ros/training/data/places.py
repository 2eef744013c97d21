"""Scenes to learn from, place by place: what a network needs that has to steer anywhere.

A program that draws its place at random builds its ground anew for each picture. Here every place
has its pictures one after the other, spread over the runway, to all sides, all daylight
hours of the year and all weather. If the network sees through the eye, they are also of many
cameras on two aircraft: of the paper's wing camera, in its place or moved, and of random ones.
"""

from __future__ import annotations

import datetime
import hashlib
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from taxinet_ros.core.camera.airframe import covering_doubts
from taxinet_ros.core.camera.light import sun_position
from taxinet_ros.core.perception.weights import Source
from taxinet_ros.core.place.catalogue import typed_place
from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.random_place import PREFIX, SPLITS
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.catalogue import AIRCRAFT, WING, find_aircraft
from taxinet_ros.core.rig.random_camera import random_camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
from taxinet_ros.errors import UsageError
from taxinet_ros.training.data.dataset import Progress

_RANGE = re.compile(f'{PREFIX}([0-9]+)-([0-9]+)')
_KEPT_BACK = ('selection', 'test')
_MOST_PLACES = 10_000
_PLACES = 4
"""Stream key that separates these random numbers from others of the same seed."""
_PER_CAMERA = 100
"""Pictures in a row of the same camera at the same place."""
_MOST_ASIDE_M, _MOST_TURNED_RAD = 10.5, math.radians(36.0)
"""Somewhat more than a test has, so that a network need not extrapolate when it overshoots."""
_NEAR, _NEAR_M, _NEAR_RAD = 0.4, 2.5, math.radians(10.0)
"""Share of the pictures where an aircraft is that follows the line, and how near [m], [rad]."""
_AT_CROSSING, _CROSSING_M = 0.2, 150.0
"""Share of the pictures at crossings, where there are any, and how near to them [m]."""
_LOWEST_SUN_RAD = math.radians(-1.0)
_TRIES = 50
_AS_IT_IS, _MOVED = 0.35, 0.25
"""Shares of the wing camera in its place, and moved; the other cameras are random."""
_MOST_MOVED_M, _MOST_TURNED_DEG = 0.35, 3.5


def named_places(words: Sequence[str]) -> tuple[str, ...]:
    """Places of words: ``random:0-299``, ``random:train``, or what names one place.

    Raises:
        UsageError: there is none, one is given twice, or is of those that no training may see.
    """
    found: list[str] = []
    for word in words:
        numbered = _RANGE.fullmatch(word)
        split = SPLITS.get(word.removeprefix(PREFIX)) if word.startswith(PREFIX) else None
        if numbered:
            split = range(int(numbered[1]), int(numbered[2]) + 1)
        if split is not None and not 0 < len(split) <= _MOST_PLACES:
            raise UsageError(f'train: place {word}: expected 1 to {_MOST_PLACES} places')
        found += [word] if split is None else [f'{PREFIX}{number}' for number in split]
    for word in found:
        if (number := word.removeprefix(PREFIX)) != word and number.isdecimal():
            for name in _KEPT_BACK:
                if int(number) in SPLITS[name]:
                    raise UsageError(
                        f'train: place {word}: is of the {name} places '
                        f'({PREFIX}{SPLITS[name][0]}-{SPLITS[name][-1]}), which no training may see'
                    )
    if len(set(found)) < len(found):
        twice = next(word for word in found if found.count(word) > 1)
        raise UsageError(f'train: place {twice}: is given twice; name it once')
    return tuple(found)


def places_source(word: str) -> Source:
    """Model card entry of a word of :func:`named_places`."""
    digest = hashlib.sha256()
    for one in named_places([word]):
        digest.update(typed_place(one).document.encode())
    return Source(kind='places', name=word, sha256=digest.hexdigest())


def places_scenes(
    words: Sequence[str], count: int, seed: int, *, cameras: bool, progress: Progress
) -> list[Scenario]:
    """Scenes at places, one place after the other, in equal numbers.

    Those of a place depend on the place, the seed and ``cameras`` only.

    Args:
        words: names of the places, of :func:`named_places`.
        count: number of all scenes, at least one per place.
        seed: seed of the scenes.
        cameras: whether to draw camera and aircraft, too; else the paper's.
        progress: called after every place in the stage ``scenes``.

    Raises:
        UsageError: a place is unknown, or there are too few scenes.
    """
    if count < len(words):
        raise UsageError(f'train: {count} images are fewer than {len(words)} places')
    scenes: list[Scenario] = []
    for number, word in enumerate(words):
        place = typed_place(word)
        share = count // len(words) + (number < count % len(words))
        rng = np.random.default_rng([seed, _PLACES, int(place.digest[:12], 16)])
        rig: dict[str, Any] = {}
        for index in range(share):
            if cameras and index % _PER_CAMERA == 0:
                rig = _rig(rng)
            scenes.append(_scene(place, rng, rig))
        progress('scenes', len(scenes), count)
    return scenes


def _scene(place: Place, rng: np.random.Generator, rig: dict[str, Any]) -> Scenario:
    runway = place.runway
    date, time_of_day_s = _daylight(runway, rng)
    rainy = rng.uniform() < 1 / 3
    aside_m, turned_rad = min(_MOST_ASIDE_M, runway.farthest_start_m), _MOST_TURNED_RAD
    if rng.uniform() < _NEAR:
        aside_m, turned_rad = _NEAR_M, _NEAR_RAD
    return Scenario(
        place=place.text, date=date, time_of_day_s=time_of_day_s,
        clouds=str(rng.choice(RAIN_CLOUDS if rainy else CLOUDS)),
        rain_fraction=float(rng.uniform(0.25, 1.0)) if rainy else 0.0,
        distance_m=_distance_m(runway, rng),
        cross_track_m=float(rng.uniform(-aside_m, aside_m)),
        heading_rad=float(rng.uniform(-turned_rad, turned_rad)),
        **rig,
    )


def _distance_m(runway: Runway, rng: np.random.Generator) -> float:
    if runway.crossings and rng.uniform() < _AT_CROSSING:
        at_m = runway.crossings[int(rng.integers(len(runway.crossings)))].x_m
        return float(np.clip(
            at_m + rng.uniform(-_CROSSING_M, _CROSSING_M / 2), 0.0, runway.last_start_m
        ))
    return float(rng.uniform(0.0, runway.last_start_m))


def _daylight(runway: Runway, rng: np.random.Generator) -> tuple[str, float]:
    """A date and a time between 6 and 18 h with the sun above the horizon, about."""
    for _ in range(_TRIES):
        day = datetime.date(2020, 1, 1) + datetime.timedelta(days=int(rng.integers(366)))
        time_of_day_s = float(rng.uniform(6 * 3600, 18 * 3600))
        if sun_position(day.isoformat(), time_of_day_s, runway)[1] > _LOWEST_SUN_RAD:
            return day.isoformat(), time_of_day_s
    return '2020-03-20', 12 * 3600.0


def _rig(rng: np.random.Generator) -> dict[str, Any]:
    """Aircraft and camera, as attributes of a scenario."""
    kind = rng.uniform()
    if kind < _AS_IT_IS:
        return {}
    if kind < _AS_IT_IS + _MOVED:
        moved = {
            f'camera_{key}': float(rng.uniform(-_MOST_MOVED_M, _MOST_MOVED_M))
            for key in ('dx_m', 'dy_m', 'dz_m')
        }
        turned = {
            f'camera_{key}': math.radians(rng.uniform(-_MOST_TURNED_DEG, _MOST_TURNED_DEG))
            for key in ('droll_rad', 'dpitch_rad', 'dyaw_rad')
        }
        return {'camera': WING.text, **moved, **turned}
    aircraft = find_aircraft(str(rng.choice(AIRCRAFT.shipped)))
    return {'aircraft': aircraft.text, 'camera': _uncovered_camera(aircraft, rng)}


def _uncovered_camera(aircraft: AircraftModel, rng: np.random.Generator) -> str:
    for _ in range(_TRIES):
        camera = random_camera(rng, aircraft.name)
        if not covering_doubts(aircraft, camera):
            return camera.text
    return WING.text
