"""The search for the nearest failing point, with known functions in place of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taxinet_ros.trials.shrink.algorithm import Axis, End, Point, ShrinkSearch

Rho = Callable[[Point], float]


def finish(search: ShrinkSearch, rho: Rho, workers: int = 1, seed: int = 0) -> list[Point]:
    """Answer a search as so many workers would, in any order; the points that were run."""
    random, under_way, run = Random(seed), list[Point](), list[Point]()
    while True:
        for point in search.wanted:
            if point not in under_way and len(under_way) < workers:
                under_way.append(point)
        if not under_way:
            return run
        point = under_way.pop(random.randrange(len(under_way)))
        search.tell(point, rho(point))
        run.append(point)


def neighbours(search: ShrinkSearch, at: Point) -> list[tuple[Point, Point]]:
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


def minimal(search: ShrinkSearch, rho: Rho) -> Point:
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


AXES = st.lists(
    st.builds(Axis, steps=st.integers(1, 40), scan=st.booleans()), min_size=1, max_size=5
)


def hashed(seed: int) -> tuple[float, ...]:
    return tuple(((seed * (k + 3) * 2654435761) % 997) / 997 for k in range(8))


def wild(axes: list[Axis], seed: int, share: float):
    """A failure without any order in it, but for the start, which fails, and the origin."""
    start, weights = tuple(axis.steps for axis in axes), hashed(seed)

    def rho(point: Point) -> float:
        if point == start:
            return -1.0
        if not any(point):
            return 1.0
        mixed = sum(w * (steps + 1) ** 2 for w, steps in zip(weights, point, strict=False))
        return mixed * 7919 % 1 - share

    return rho


@given(AXES, st.integers(1, 10**6), st.floats(0.05, 0.95))
@settings(max_examples=60, deadline=None)
def test_given_any_failure_when_shrunk_then_it_fails_and_every_axis_is_as_near_as_it_can_be(
    axes, seed, share
):
    rho = wild(axes, seed, share)
    search = ShrinkSearch(axes, most=100_000)
    run = finish(search, rho)
    assert distinct(run)
    at = minimal(search, rho)
    assert all(steps <= axis.steps for steps, axis in zip(at, axes, strict=True))


@given(AXES, st.integers(1, 10**6), st.floats(0.05, 0.95), st.integers(2, 8), st.integers(0, 99))
@settings(max_examples=50, deadline=None)
def test_given_more_workers_and_any_order_of_answers_then_the_points_are_those_of_one(
    axes, seed, share, workers, order
):
    rho = wild(axes, seed, share)
    one, many = ShrinkSearch(axes, most=100_000), ShrinkSearch(axes, most=100_000)
    alone = finish(one, rho)
    run = finish(many, rho, workers, order)
    assert distinct(run)
    assert many.state == one.state
    assert set(run) == set(alone)


@given(st.lists(st.tuples(st.integers(1, 60), st.integers(0, 60)), min_size=1, max_size=5))
@settings(deadline=None)
def test_given_a_failure_that_grows_with_every_axis_then_its_corner_is_found(pairs):
    limits = [min(limit, steps) for steps, limit in pairs]
    search = ShrinkSearch([Axis(steps=steps) for steps, _ in pairs], most=10_000)
    finish(search, beyond(*limits))
    if any(limits):
        assert search.state.at == tuple(limits)
        minimal(search, beyond(*limits))
    else:
        assert search.state.end is End.NOMINAL_FAILS


def test_given_a_failure_of_one_axis_of_six_then_few_runs_find_it():
    search = ShrinkSearch([Axis(steps=80)] * 6, most=100)
    run = finish(search, beyond(0, 0, 37, 0, 0, 0))
    assert search.state.at == (0, 0, 37, 0, 0, 0)
    # Two ends, six single axes, five at once, the rest of that, and seven halvings of 80.
    assert len(run) <= 2 + 6 + 1 + 1 + 7 + 1


def test_given_either_of_two_axes_suffices_then_the_worse_is_kept_and_the_other_is_not_needed():
    def rho(point: Point) -> float:
        return -2.0 if point[1] else (-1.0 if point[0] else 1.0)

    search = ShrinkSearch([Axis(steps=9), Axis(steps=9)], most=50)
    finish(search, rho)
    assert search.state.at == (0, 1)


def test_given_words_then_the_first_from_nominal_that_fails_is_taken_though_bisection_misses_it():
    def rho(point: Point) -> float:
        return -1.0 if point[0] in (1, 5) else 1.0

    words, numbers = (ShrinkSearch([Axis(steps=5, scan=scan)], most=50) for scan in (True, False))
    finish(words, rho)
    finish(numbers, rho)
    assert (words.state.at, numbers.state.at) == ((1,), (5,))


def test_given_a_rule_then_no_impossible_point_is_asked_for():
    def dry(point: Point, axis: int) -> Point:
        """Rain, the second axis, falls from the last of three skies only."""
        return (point[0], 0) if point[0] < 2 and point[1] else point

    search = ShrinkSearch([Axis(steps=2, scan=True), Axis(steps=50)], most=50, rule=dry)
    run = finish(search, beyond(0, 20), workers=3)
    assert search.state.at == (2, 20)
    assert all(sky == 2 or rain == 0 for sky, rain in run)


def test_given_a_start_that_passes_or_an_origin_that_fails_then_two_answers_end_the_search():
    for rho, end, at in ((1.0, End.NOT_REPRODUCED, (5,)), (0.0, End.NOMINAL_FAILS, (0,))):
        search = ShrinkSearch([Axis(steps=5)], most=50)
        assert search.wanted == [(5,), (0,)]
        assert len(finish(search, lambda point, rho=rho: rho)) == 2
        assert (search.state.end, search.state.at) == (end, at)


def test_given_few_runs_then_the_nearest_failing_point_so_far_is_kept():
    rho = beyond(3, 30, 0)
    axes = [Axis(steps=60)] * 3
    whole = ShrinkSearch(axes, most=1000)
    needed = len(finish(whole, rho))
    before = axes[0].steps * 3
    for most in range(2, needed + 1):
        search = ShrinkSearch(axes, most=most)
        assert len(finish(search, rho)) <= most
        assert rho(search.state.at) <= 0
        assert sum(search.state.at) <= before
        before = sum(search.state.at)
        assert search.state.end is (End.MINIMAL if most == needed else End.SPENT)
    assert before == 33


def test_given_fewer_runs_than_parameters_then_all_are_made_and_what_they_found_is_kept():
    search = ShrinkSearch([Axis(steps=60)] * 6, most=4)
    assert len(finish(search, beyond(0, 0, 0, 0, 0, 30))) == 4
    assert (search.state.at, search.state.end) == ((0, 60, 60, 60, 60, 60), End.SPENT)


@pytest.mark.parametrize(('axes', 'most'), [([], 9), ([Axis(steps=0)], 9), ([Axis(steps=1)], 1)])
def test_given_nothing_to_search_then_that_is_refused(axes, most):
    with pytest.raises(ValueError, match='at most'):
        ShrinkSearch(axes, most=most)


def test_given_a_robustness_of_exactly_zero_then_it_fails():
    search = ShrinkSearch([Axis(steps=9), Axis(steps=9), Axis(steps=9, scan=True)], most=50)
    finish(search, lambda point: 0.0 if point[0] >= 4 else 1.0)
    assert search.state.at == (4, 0, 0)
