"""Subset simulation: known probabilities, and honesty where they cannot be known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.sampler import Exhausted, Lagged
from taxinet_ros.samplers.space import Dimension, Point, Space
from taxinet_ros.samplers.splitting import (
    LOOK_TAIL,
    RareEstimate,
    Splitting,
    State,
    estimate,
    least_mean,
    particles_for,
)
from taxinet_ros.samplers.subset_simulation import (
    Island,
    Level,
    Plan,
    SubsetSimulation,
)
from taxinet_ros.trials.rates import share_bounds

pytestmark = pytest.mark.nightly

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
    values = {'draws': runs // 2, 'particles': 40, 'islands': 6, 'floor': 1e-5} | options
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
    ended = sampler.ended()
    assert isinstance(ended, Splitting)
    return ended.estimate(), points, sampler


@pytest.mark.parametrize('make', [corner, twins, of_one_kind])
def test_given_a_known_probability_when_estimated_then_intervals_hold_on_both_sides(
    make: Callable[[float], Rho],
) -> None:
    truth = 2e-4
    found = [run(make(truth), seed, 4000)[0] for seed in range(2)]
    assert all(one.low <= truth <= one.high for one in found)
    assert max(one.low for one in found) > truth / 10
    assert {one.plain for one in found} == {''}
    assert [(one.drawn, one.high) for one in found] == [
        (2000, share_bounds(one.drawn_failed, 2000 - one.drawn_failed, LOOK_TAIL)[1])
        for one in found
    ]


def test_given_many_failures_when_estimated_then_all_is_drawn_plainly_and_it_says_so() -> None:
    found, points, sampler = run(corner(0.02), 1, 1000)
    fails = [corner(0.02)(point) <= 0 for point in points]
    assert found.plain == f'{sum(fails[:500])} of the first 500 failed'
    assert (found.runs, found.drawn, found.islands) == (1000, 1000, 0)
    failed = sum(fails)
    assert (found.low, found.high) == share_bounds(failed, 1000 - failed, LOOK_TAIL)
    assert found.state is State.ESTIMATED
    # The second half depends on the results of the first, so no other rate counts it.
    assert [sampler.drawn(index) for index in range(1000)] == [True] * 500 + [False] * 500


def test_given_only_scenes_that_the_program_accepts_when_estimated_then_given_these() -> None:
    # Of the accepted half, with z below 0.5, one in five thousand fails.
    found, points, sampler = run(corner(2e-4), 1, refused=lambda point: point[2] - 0.5)
    assert all(point[2] <= 0.5 for point in points)
    assert 0 < found.low <= 2e-4 <= found.high
    assert found.islands == 6
    drawn = [sampler.drawn(index) for index in range(len(points))]
    assert drawn == [True] * 1500 + [False] * (len(points) - 1500)
    assert found.drawn == 1500
    assert found.drawn_failed == sum(corner(2e-4)(point) <= 0 for point in points[:1500])


def test_given_flat_robustness_when_estimated_then_all_is_drawn_plainly() -> None:
    found, points, _ = run(lambda point: 1.0, 1, 360)
    assert 'the least results of the first 180 are equal' in found.plain
    assert len(points) == 360
    assert (found.low, found.high) == (0.0, pytest.approx(1 - LOOK_TAIL ** (1 / 360)))
    assert found.state is State.UNCLEAR


def test_given_a_cliff_without_slope_when_estimated_then_the_interval_holds() -> None:
    # Nothing leads to the failures, which are one in a thousand.
    def cliff(point: Point) -> float:
        return -1.0 if max(point[0], point[1]) < 1e-3**0.5 else 1.0 + point[2]

    found = [run(cliff, seed, 2000)[0] for seed in range(2)]
    assert all(one.low <= 1e-3 <= one.high for one in found)


@pytest.mark.parametrize('runs', [500, 700])
def test_given_too_few_runs_when_estimated_then_the_islands_cut_off_found_nothing(runs) -> None:
    found = run(corner(1e-4), 1, runs=runs, draws=500)[0]
    assert (found.low, found.drawn) == (0.0, 500)
    assert found.high == pytest.approx(1 - LOOK_TAIL ** (1 / found.drawn))


@pytest.mark.parametrize(('share', 'told', 'draws'), [
    (1e-4, 0, (0, 500)), (1e-4, 499, (499, 500)), (0.02, 500, (500, 1000)),
    (0.02, 999, (999, 1000)),
])
def test_an_interval_needs_all_draws_that_were_planned(share, told, draws) -> None:
    sampler = make_sampler('splitting', SPACE, 1, 1000, draws=500, particles=40)
    for _ in range(told):
        index, point = sampler.next()
        # A run without a result has ended, too.
        sampler.tell(index, None if index == 7 else corner(share)(point))
    ended = sampler.ended()
    assert isinstance(ended, Splitting)
    assert ended.draws() == draws
    with pytest.raises(ValueError, match=f'{draws[0]} of {draws[1]} planned draws have ended'):
        ended.estimate()


def test_islands_that_were_cut_off_count_as_without_a_failure() -> None:
    simulation = SubsetSimulation(SPACE, 1, Plan(draws=500, particles=40))
    plain = Level(below=np.inf, probability=1.0, rho=(0.1, 0.2))
    simulation.islands += [Island(wave=1, levels=[plain], failing=1e-4) for _ in range(8)]
    ended = estimate(simulation, np.ones(500), 900)
    assert ended.low == least_mean(np.full(8, 1e-4), LOOK_TAIL) > 0
    simulation.islands += [Island(wave=2, levels=[plain]) for _ in range(8)]
    cut = estimate(simulation, np.ones(500), 1000)
    assert cut.low == least_mean(np.repeat([1e-4, 0.0], 8), LOOK_TAIL)
    assert 0 < cut.low < ended.low
    assert cut.high == ended.high


def test_a_move_that_an_interrupt_cut_off_is_not_taken_for_one_that_was_refused() -> None:
    sampler = make_sampler('splitting', SPACE, 1, 400, draws=60, particles=20, islands=2)
    for _ in range(60):
        index, point = sampler.next()
        sampler.tell(index, corner(1e-4)(point))
    batch = []
    while sampler.ready:
        batch.append(sampler.next())
    for index, point in batch[:-1]:
        sampler.tell(index, corner(1e-4)(point))
    ended = sampler.ended()
    assert isinstance(ended, Splitting)
    assert (ended.estimate().drawn, ended.estimate().low) == (60, 0.0)
    assert [len(one.known) for one in ended.simulation.islands] == [1]


def test_given_runs_without_a_result_when_estimated_then_the_rest_still_counts() -> None:
    broken = iter(range(10_000))
    found = run(lambda point: None if next(broken) % 9 == 4 else corner(2e-4)(point), 2)[0]
    assert found.drawn == 1500 - 167
    assert 0 < found.low <= 2e-4 <= found.high


def test_given_a_tail_when_estimated_then_its_band_at_0_is_the_interval_itself() -> None:
    found = run(corner(2e-4), 3)[0]
    assert found.islands == 6
    [at_zero] = [point for point in found.curve if not point[0]]
    assert at_zero == (0.0, found.probability, found.low, found.high)
    assert all(low <= high for _, _, low, high in found.curve)


def test_given_results_in_another_order_when_asked_then_the_same_points_follow() -> None:
    options = {'draws': 60, 'particles': 20, 'islands': 2}
    rho = corner(1e-4)
    first = run(rho, 5, runs=140, **options)[1]
    sampler = make_sampler('splitting', SPACE, 5, 140, **options, floor=1e-5)
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
        run(corner(1e-4), 3, runs=runs, draws=120, particles=20, islands=2)[1]
        for runs in (400, 800)
    )
    assert len(few) < len(many)
    assert many[:len(few)] == few


def test_given_values_that_agree_when_bounded_then_the_lower_limit_of_their_mean_is_near() -> None:
    ones = np.ones(8)
    # No law allows more than the eighth root.
    assert 0.4 < least_mean(ones, LOOK_TAIL) < LOOK_TAIL ** (1 / 8)
    assert least_mean(3 * ones, LOOK_TAIL) == pytest.approx(3 * least_mean(ones, LOOK_TAIL))
    assert least_mean(np.array([0.0, 0, 0, 8]), LOOK_TAIL) < 0.05
    assert least_mean(np.zeros(8), LOOK_TAIL) == 0


@pytest.mark.parametrize(('values', 'least'), [
    ([1e-4] * 36 + [0.0], 7.889e-5),
    ([1e-4] * 88, 9.340e-5),
    ([1e-4] * 87 + [0.0], 9.054e-5),
    ([1e-9] * 300 + [0.0] * 10, 9.230e-10),
])
def test_the_lower_limit_of_many_islands_hardly_depends_on_their_order(values, least) -> None:
    given = np.array(values)
    one, other = least_mean(given, LOOK_TAIL), least_mean(given[::-1], LOOK_TAIL)
    assert one == pytest.approx(other, rel=1e-6)
    assert one == pytest.approx(least, rel=0.001)


@pytest.mark.parametrize('share', [0.9, 0.5, 0.2, 0.05])
def test_given_skewed_values_when_bounded_then_the_limit_is_seldom_above_their_mean(share) -> None:
    # Zero, or with this probability so great that their mean is 1: the law in which it is highest.
    values = np.random.default_rng(1).binomial(1, share, (500, 8)) / share
    above = np.mean([least_mean(one, LOOK_TAIL) > 1 for one in values])
    assert above <= LOOK_TAIL + 3 * (LOOK_TAIL / 500) ** 0.5


def test_given_a_budget_when_planned_then_it_suffices_for_the_least_probability() -> None:
    assert particles_for(4000, 8, 1e-5) == 35
    assert particles_for(4000, 8, 1e-6) == 30
    assert particles_for(100, 8, 1e-6) == 0
    found, points, sampler = run(corner(1e-5), 2, runs=4000, particles=35, islands=8)
    assert found.islands == 8
    assert 3000 < len(points) < 4000
    assert {one.failing is None for one in sampler.sampler.simulation.islands} == {False}
    assert found.failing >= 1
