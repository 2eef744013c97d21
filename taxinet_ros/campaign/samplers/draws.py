"""Random numbers by the number of the run: no state, so any run's can be had at any time."""

from __future__ import annotations

import numpy as np

from taxinet_ros.campaign.samplers.space import Point, Space


def generator(
    seed: int, index: int, attempt: int = 0, *, stream: int = 0
) -> np.random.Generator:
    """Random numbers of run ``index`` (0, 1, …) in a campaign with a seed (0 or more).

    Args:
        seed: of the campaign.
        index: of the run.
        attempt: how many points of this run were refused before.
        stream: another one has independent numbers for the same run.
    """
    key = (index, attempt, stream) if stream else (index, attempt) if attempt else (index,)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def prior_point(space: Space, seed: int, index: int, attempt: int = 0) -> Point:
    """The point of run ``index`` where it is simply drawn from the prior."""
    return space.point(generator(seed, index, attempt).random(len(space)))
