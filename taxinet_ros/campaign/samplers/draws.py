"""Random numbers by the number of the run: no state, so any run's can be had at any time."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from taxinet_ros.campaign.samplers.space import Point

BELOW_ONE = math.nextafter(1.0, 0.0)
"""The largest quantile."""


def generator(seed: int, index: int, *stream: int) -> np.random.Generator:
    """Random numbers of run ``index`` (0, 1, …) in a campaign with a seed (0 or more).

    Another ``stream`` of the same run is independent of the first.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index, *stream)))


def as_point(coordinates: Iterable[float]) -> Point:
    """The point with these coordinates 0 … 1; a 1, which rounding may give, falls just below."""
    return tuple(min(float(coordinate), BELOW_ONE) for coordinate in coordinates)


def prior_point(dimensions: int, seed: int, index: int) -> Point:
    """The point of run ``index`` where it is simply drawn from the prior."""
    return as_point(generator(seed, index).random(dimensions))
