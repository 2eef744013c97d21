"""Active search on landscapes: rare failures, all regions of them, and failures that differ."""

from __future__ import annotations

from statistics import fmean

import numpy as np
import pytest
from searches import LANDSCAPES, Landscape, Search, count_distinct, search

from taxinet_ros.samplers.space import Branch, Dimension, Point, Space, prior_point

pytestmark = pytest.mark.nightly


def means(landscape: str, word: str, seeds: int, runs: int = 200) -> Search:
    done = [search(landscape, word, seed, runs) for seed in range(seeds)]
    return Search(**{
        name: fmean(getattr(one, name) for one in done)
        for name in ('found', 'regions', 'failures', 'distinct', 'ask_s')
    })


# `benchmarks/searches.py active` has 100 seeds, and benchmarks/RESULTS.md what came of them.
@pytest.mark.parametrize(('landscape', 'seeds'), [('corner', 3), ('twins', 2), ('four', 2)])
def test_t7_given_a_rare_corner_or_several_regions_when_searched_then_all_are_found(
    landscape: str, seeds: int
) -> None:
    found = means(landscape, 'active', seeds)
    assert found.found == 1
    assert found.regions >= 0.9
    assert found.failures > 5 * means(landscape, 'ce', 10).failures


@pytest.mark.parametrize('landscape', [
    'corner-6', 'four-2', 'four-6', 'eight', 'balls', 'categories', 'conditional', 'plateau',
    'steps', 'stopped', 'rough', 'decoy',
])
def test_t7_given_a_hard_landscape_when_searched_then_its_regions_are_found(
    landscape: str,
) -> None:
    assert search(landscape, 'active', 1).regions >= 0.75


def test_t7_given_most_of_the_space_fails_when_searched_then_failures_lie_farther_apart() -> None:
    assert means('most', 'active', 1).distinct > 1.1 * means('most', 'random', 3).distinct


def test_t7_given_no_slope_to_go_by_when_searched_then_it_does_no_worse_than_chance() -> None:
    assert means('blind', 'active', 2).regions >= means('blind', 'random', 3).regions - 0.2


@pytest.mark.parametrize('name', LANDSCAPES)
def test_t7_given_a_landscape_when_drawn_from_then_its_failures_are_in_its_regions(
    name: str,
) -> None:
    landscape = LANDSCAPES[name]
    for region in range(landscape.regions):
        assert _region_is_there(landscape, region)


def _region_is_there(landscape: Landscape, region: int) -> bool:
    """A thousand times the usual draws, where they matter: descend from plain draws."""
    chance = np.random.default_rng(region)
    at = min(
        (prior_point(landscape.space, region, number) for number in range(600)),
        key=lambda point: landscape.parts(point)[region],
    )
    for scale in (0.1, 0.03, 0.01):
        for _ in range(200):
            moved = landscape.space.point(
                chance.random() if each is None
                else min(abs(each + scale * chance.standard_normal()), 1.0)
                for each in at
            )
            at = min(at, moved, key=lambda point: landscape.parts(point)[region])
    return landscape.rho(at) <= 0 and landscape.region(at) == region


def test_given_failures_when_counted_then_those_that_are_alike_count_once() -> None:
    space = Space((
        Dimension(name='kind', weights=(1, 1)), Dimension(name='x'),
        Dimension(name='wet', when=(Branch('kind', (1,)),)),
    ))
    one: Point = (0.1, 0.5, None)
    assert count_distinct(space, []) == 0
    assert count_distinct(space, [one, (0.4, 0.6, None), one]) == 1
    assert count_distinct(space, [one, (0.1, 0.7, None), (0.9, 0.5, 0.5), (0.9, 0.5, 0.1)]) == 4
