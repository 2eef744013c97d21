"""Shrinking by a formula: no ROS, no scenario."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random

from taxinet_ros.campaign.shrink import End, Point, Shrink

Rho = Callable[[Point], float]


def finish(search: Shrink, rho: Rho, workers: int = 1, seed: int = 0) -> list[Point]:
    """Answer a search as so many workers would, in any order; the points that were run."""
    random, under_way, run = Random(seed), list[Point](), list[Point]()
    while True:
        for point in search.wanted(workers):
            if point not in under_way and len(under_way) < workers:
                under_way.append(point)
        if not under_way:
            return run
        point = under_way.pop(random.randrange(len(under_way)))
        search.tell(point, rho(point))
        run.append(point)


def neighbours(search: Shrink, at: Point) -> list[tuple[Point, Point]]:
    """For each axis that is not nominal: the point with it made nominal, and one step nearer."""
    return [
        (search.moved(at, axis, 0), search.moved(at, axis, steps - 1))
        for axis, steps in enumerate(at) if steps
    ]


def beyond(*limits: int) -> Rho:
    """Fails where every axis is at its limit or beyond: monotone."""
    return lambda point: max(
        (limit - steps - 0.5 for limit, steps in zip(limits, point, strict=True) if limit),
        default=-1.0,
    )


def minimal(search: Shrink, rho: Rho) -> Point:
    """Where a search ended, seen to be a local minimum."""
    state = search.state
    assert state.end is End.MINIMAL
    assert rho(state.at) <= 0
    for whole, step in neighbours(search, state.at):
        assert rho(whole) > 0
        assert rho(step) > 0
        assert search.rho(whole) == rho(whole), 'has been run, not guessed'
        assert search.rho(step) == rho(step)
    return state.at


def distinct(points: Sequence[Point]) -> bool:
    return len(set(points)) == len(points)
