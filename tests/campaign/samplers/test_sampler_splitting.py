"""Subset simulation: known probabilities, and honesty where they cannot be known."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from taxinet_ros.campaign.samplers.registry import make_sampler
from taxinet_ros.campaign.samplers.sampler import Exhausted, Lagged
from taxinet_ros.campaign.samplers.space import Dimension, Point, Space
from taxinet_ros.campaign.samplers.splitting import (
    RareEstimate,
    Splitting,
    State,
    log_interval,
    particles_for,
)

SPACE = Space((
    Dimension(name='x'), Dimension(name='y'), Dimension(name='z'),
    Dimension(name='kind', weights=(3, 1)),
))
Rho = Callable[[Point], float]


def corner(probability: float) -> Rho:
    side = probability**0.5
    return lambda point: max(point[0], point[1]) - side


def twins(probability: float) -> Rho:
    half = (probability / 2) ** 0.5 / 2
    return lambda point: min(
        max(abs(point[0] - at), abs(point[1] - at)) for at in (0.25, 0.75)
    ) - half


def of_one_kind(probability: float) -> Rho:
    side = (4 * probability) ** 0.5
    return lambda point: max(point[0], point[1]) - side + (0.0 if point[3] >= 0.75 else 0.3)


def run(
    rho: Callable[[Point], float | None], seed: int, runs: int = 3000, refused: Rho | None = None,
    **options: float,
) -> tuple[RareEstimate, list[Point], Lagged]:
    """All runs of a search, one after another."""
    values = {'particles': 60, 'islands': 6, 'error': 10, 'floor': 1e-6} | options
    sampler = make_sampler('splitting', SPACE, seed, runs, **values)
    points = []
    try:
        while len(points) < runs:
            assert sampler.ready
            index, point = sampler.next()
            while refused is not None and refused(point) > 0:
                point = sampler.again()
            points.append(point)
            sampler.tell(index, rho(point))
    except Exhausted:
        pass
    assert isinstance(sampler.sampler, Splitting)
    return sampler.sampler.estimate(), points, sampler


@pytest.mark.parametrize('make', [corner, twins, of_one_kind])
def test_given_a_known_probability_when_estimated_then_intervals_hold_and_are_narrow(
    make: Callable[[float], Rho],
) -> None:
    truth = 1e-4
    found = [run(make(truth), seed, 6000, particles=120)[0] for seed in range(4)]
    assert [one.state for one in found] == [State.ESTIMATED] * 4
    # A 95 % interval misses two of four once in a hundred times.
    assert sum(one.low <= truth <= one.high for one in found) >= 3
    assert np.mean([one.probability for one in found]) == pytest.approx(truth, rel=0.5)
    plain = math.sqrt(1 / truth / np.mean([one.runs for one in found]))
    assert np.mean([one.relative_error for one in found]) < plain / 4


def test_given_only_scenes_that_the_program_accepts_when_estimated_then_given_these() -> None:
    # Of the accepted half, with z below 0.5, one in a hundred fails.
    found, points, sampler = run(
        corner(0.01), 1, refused=lambda point: point[2] - 0.5, particles=100
    )
    assert all(point[2] <= 0.5 for point in points)
    assert found.low <= 0.01 <= found.high
    assert found.relative_error < 0.4
    drawn = [sampler.drawn(index) for index in range(len(points))]
    assert drawn == [True] * 600 + [False] * (len(points) - 600)
    assert found.drawn == 600
    assert found.drawn_failed == sum(corner(0.01)(point) <= 0 for point in points[:600])


def test_given_flat_robustness_when_estimated_then_only_plain_draws_say_anything() -> None:
    found, points, _ = run(lambda point: 1.0, 1)
    assert found.state is State.AT_MOST
    assert len(points) == 360
    assert (found.low, found.high) == (0.0, pytest.approx(1 - 0.025 ** (1 / 360)))
    assert 'flat' in found.why


def test_given_a_cliff_without_slope_when_estimated_then_it_is_not_called_an_estimate() -> None:
    # Nothing leads to the failures, which are one in a hundred thousand.
    def cliff(point: Point) -> float:
        return -1.0 if max(point[0], point[1]) < 1e-5**0.5 else 1.0 + point[2]

    found = run(cliff, 1)[0]
    assert found.state is not State.ESTIMATED
    assert found.high > 1e-5


def test_given_too_few_runs_when_estimated_then_at_most_the_level_reached() -> None:
    found = run(corner(1e-6), 1, runs=700)[0]
    assert found.state is State.AT_MOST
    assert found.low == 0 < 1e-6 < found.high
    assert 'not ended' in found.why


def test_given_nothing_fails_when_estimated_then_at_most_a_small_probability() -> None:
    found = run(lambda point: max(point[0], point[1]) + 1e-9, 1, runs=9000, particles=100)[0]
    assert (found.state, found.failing) == (State.AT_MOST, 0)
    assert 0 < found.high < 1e-3


def test_given_runs_without_a_result_when_estimated_then_the_rest_still_counts() -> None:
    broken = iter(range(10_000))
    found = run(lambda point: None if next(broken) % 9 == 4 else corner(0.01)(point), 2)[0]
    assert found.low <= 0.01 <= found.high


def test_given_results_in_another_order_when_asked_then_the_same_points_follow() -> None:
    options = {'particles': 20, 'islands': 2, 'error': 10}
    rho = corner(0.01)
    first = run(rho, 5, runs=120, **options)[1]
    sampler = make_sampler('splitting', SPACE, 5, 120, **options, floor=1e-6)
    points: list[Point] = []
    waiting: list[tuple[int, Point]] = []
    while len(points) < len(first):
        while sampler.ready and len(waiting) < 8 and len(points) < len(first):
            index, point = sampler.next()
            points.append(point)
            waiting.append((index, point))
        index, point = waiting.pop()  # the last one first
        sampler.tell(index, rho(point))
    assert points == first


def test_given_more_runs_when_continued_then_the_earlier_runs_are_the_same() -> None:
    few, many = (
        run(corner(0.01), 3, runs=runs, particles=20, islands=2, error=0)[1] for runs in (300, 600)
    )
    assert len(few) < len(many)
    assert many[:len(few)] == few


def test_given_a_mean_and_its_error_when_bounded_then_the_interval_is_students() -> None:
    low, high = log_interval(1e-3, 0.2, 8)
    assert math.log(high / 1e-3) == pytest.approx(2.3646 * 0.2, rel=1e-4)
    assert low * high == pytest.approx(1e-6)


def test_given_a_budget_when_planned_then_it_suffices_for_the_least_probability() -> None:
    assert particles_for(4000, 8, 1e-6) == 60
    assert particles_for(4000, 8, 1e-4) == 85
    found = run(corner(1e-6), 2, runs=4000, particles=60, islands=8)[0]
    assert found.state is not State.AT_MOST
    assert found.failing >= 4
