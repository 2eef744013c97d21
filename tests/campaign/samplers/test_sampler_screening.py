"""Screening: looks before runs, good, biased, worthless and misleading ones."""

from __future__ import annotations

from statistics import fmean

import pytest

from taxinet_ros.bench.screening import LOOKS, search_landscape, spend
from taxinet_ros.bench.searches import LANDSCAPES
from taxinet_ros.campaign.samplers.registry import make_sampler, make_screening_sampler
from taxinet_ros.campaign.samplers.screening import LOOK_COST, NAME, Way
from taxinet_ros.campaign.samplers.space import Dimension, Point, Space

SPACE = Space((Dimension(name='x'), Dimension(name='kind', weights=(2, 1)), Dimension(name='y')))
SEEDS = range(3)


def corner(point: Point) -> float:
    return max(point[0] or 0.0, point[2] or 0.0) - 0.2


def distinct(landscape: str, word: str, quality: str, budget: float) -> float:
    return fmean(
        len(search_landscape(landscape, quality, word, seed, budget).distinct) for seed in SEEDS
    )


# `taxinet bench screening` has more seeds, and docs/cheap_search.md what came of them.
@pytest.mark.parametrize('landscape', ['twins', 'categories'])
def test_given_good_looks_and_a_small_budget_then_many_more_distinct_failures_are_found(
    landscape: str,
) -> None:
    active = distinct(landscape, 'active', '', 30)
    assert distinct(landscape, NAME, 'good', 30) >= 2 * max(active, 1)


@pytest.mark.parametrize('quality', ['worthless', 'misleading'])
def test_given_looks_that_tell_nothing_then_most_of_what_active_finds_is_found(
    quality: str,
) -> None:
    active = distinct('twins', 'active', '', 100)
    found = distinct('twins', NAME, quality, 100)
    assert found >= 0.6 * active
    assert found < 1.1 * active, 'these looks do tell something'


def test_given_looks_that_are_somewhat_too_high_then_half_as_many_failures_are_found() -> None:
    def found(bias: float) -> int:
        return spend(
            NAME, SPACE, 1, 40.0, corner, lambda point: corner(point) + bias, lag=1
        ).failures

    assert found(0.1) >= 0.5 * found(0.0)
    assert found(0.0) >= 15


def test_given_no_looks_then_it_is_an_active_search() -> None:
    both = [make_sampler(word, SPACE, 3, 40) for word in (NAME, 'active')]
    for _ in range(40):
        (index, point), (_, other) = (sampler.next() for sampler in both)
        assert point == other
        for sampler in both:
            sampler.tell(index, corner(point))


def test_given_looks_without_a_result_then_runs_are_chosen_by_results_alone() -> None:
    points: list[Point] = []
    sampler, screening = make_screening_sampler(SPACE, 0, points.append)
    for _ in range(6):
        index, point = sampler.next()
        sampler.tell(index, corner(point))
    assert set(screening.chosen) == {Way.RESULTS}
    assert len(points) > 20
    assert screening.looks == 0


def test_given_a_budget_then_runs_and_looks_together_keep_to_it() -> None:
    found = search_landscape('corner', 'fair', NAME, 0, 25.0)
    assert found.looks > 0
    assert 20 < found.runs + LOOK_COST * found.looks <= 25.0
    assert list(found.distinct) == sorted(found.distinct)
    assert search_landscape('corner', 'fair', NAME, 0, 25.0).distinct == found.distinct


def test_given_refused_points_then_another_that_was_looked_at_is_run() -> None:
    sampler, screening = make_screening_sampler(SPACE, 0, corner, floor=0)
    _, first = sampler.next()
    second = sampler.again()
    assert second != first
    assert screening.chosen == {Way.LOOKS: 1}
    for _ in range(20):
        SPACE.check(sampler.again())
    assert screening.chosen == {Way.PRIOR: 1}


def test_given_the_looks_of_landscapes_then_they_are_as_good_as_they_say() -> None:
    place = LANDSCAPES['twins']
    points = [tuple(seed / 97 * each % 1.0 for each in (1, 31, 57, 83)) for seed in range(97)]
    off = {name: [look(place, one) - place.rho(one) for one in points]
           for name, look in LOOKS.items()}
    spread = {name: fmean(abs(each) for each in values) for name, values in off.items()}
    assert spread['good'] < 0.03 < spread['fair'] < 0.12 < spread['worthless']
    assert spread['misleading'] > 0.1
