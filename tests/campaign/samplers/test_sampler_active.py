"""Active search: rare failures, all regions of them, and failures that differ."""

from __future__ import annotations

import math
from statistics import fmean

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern

from taxinet_ros.bench.searches import LANDSCAPES, Landscape, Search, count_distinct, search
from taxinet_ros.campaign.samplers.active_search import (
    PATIENCE,
    WINDOW,
    ActiveSearch,
    Features,
    GaussianProcess,
)
from taxinet_ros.campaign.samplers.registry import make_sampler
from taxinet_ros.campaign.samplers.space import Branch, Dimension, Point, Space, prior_point

SPACE = Space((Dimension(name='x'), Dimension(name='kind', weights=(2, 1)), Dimension(name='y')))


def means(landscape: str, word: str, seeds: int, runs: int = 200) -> Search:
    done = [search(landscape, word, seed, runs) for seed in range(seeds)]
    return Search(**{
        name: fmean(getattr(one, name) for one in done)
        for name in ('found', 'regions', 'failures', 'distinct', 'ask_s')
    })


# `taxinet bench searches active` has 100 seeds, and docs/falsification.md what came of them.
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


def campaign(rho, runs: int = 60, **options: float) -> list[Point]:
    sampler = make_sampler('active', SPACE, 5, runs, **options)
    points = []
    for _ in range(runs):
        index, point = sampler.next()
        points.append(point)
        sampler.tell(index, rho(point))
    return points


def bowl(point: Point) -> float:
    return math.dist((point[0] or 0.0, point[2] or 0.0), (0.3, 0.6)) - 0.2


def test_given_infinite_or_equal_robustness_when_searched_then_it_goes_on() -> None:
    for rho in (
        lambda point: math.inf if point[0] > 0.8 else -math.inf if point[0] < 0.1 else bowl(point),
        lambda point: math.inf, lambda point: -1.0, lambda point: 0.0,
    ):
        points = campaign(rho)
        assert len(set(points)) == 60
        assert 0.3 < np.mean([point[0] for point in points]) < 0.7


def test_given_robustness_in_other_units_when_searched_then_the_points_are_the_same() -> None:
    assert campaign(lambda point: 1024 * bowl(point)) == campaign(bowl)


def test_given_runs_without_result_when_searched_then_most_go_where_there_are_some() -> None:
    points = campaign(lambda point: None if point[0] < 0.5 else point[2] - 0.5, 100)
    assert sum(point[0] < 0.5 for point in points[:30]) > 10
    assert sum(point[0] >= 0.5 and point[2] < 0.5 for point in points[50:]) > 25


def test_given_a_radius_when_searched_then_failures_keep_apart() -> None:
    def apart(radius: float) -> float:
        points = [point for point in campaign(bowl, radius=radius) if bowl(point) <= 0]
        at = np.array([(x, SPACE[1].bin(kind), y) for x, kind, y in points])
        away = np.linalg.norm(at[:, None] - at, axis=2) + 9 * np.eye(len(at))
        return float(np.median(away.min(axis=1)))

    assert apart(0.3) > 1.2 * apart(0.02)


def test_given_refused_points_when_asked_again_then_others_come_and_at_last_plain_draws() -> None:
    sampler = ActiveSearch(SPACE, 3)
    for number in range(30):
        sampler.tell(number, bowl(sampler.ask()))
    points = [sampler.ask(), *(sampler.again() for _ in range(PATIENCE + 2))]
    assert len(set(points)) == len(points)
    assert points[-1] == prior_point(SPACE, 3, 30, PATIENCE + 2)
    sampler.tell(30, 1.0)
    assert bowl(sampler.ask()) < 0.5


def test_given_more_results_than_the_window_when_told_then_the_lone_ones_stay() -> None:
    sampler = ActiveSearch(SPACE, 3)
    lone = (0.9, 0.9, 0.9)
    sampler.add(lone, 1.0)
    for number in range(WINDOW + 50):
        x, _, y = prior_point(SPACE, 1, number)
        sampler.add((0.5 * (x or 0), 0.1, 0.5 * (y or 0)), 0.5 + 0.1 * (x or 0))
    sampler.add((0.1, 0.1, 0.9), 0.4)
    assert len(sampler._window) == WINDOW
    assert 0 in sampler._window


def test_given_results_when_predicted_then_scikit_learn_says_the_same() -> None:
    features = Features(SPACE)
    chance = np.random.default_rng(0)
    known, asked = features.of(chance.random((40, 3))), features.of(chance.random((25, 3)))
    others = features.of(chance.random((6, 3)))
    results = np.sin(5 * known[:, 0]) + 0.3 * known[:, 1] + 0.01 * chance.standard_normal(40)
    process = GaussianProcess(features)
    process.fit(known, results)
    x, kind, y = process.length_scales
    assert x < 1 < y
    scales, noise = np.array([x, kind, kind, y]), math.exp(process._logs[-1])

    kernel = Matern(scales, nu=1.5)
    covariance = kernel(known) + noise * np.eye(40)
    ones = np.linalg.solve(covariance, np.ones(40))
    level = ones @ results / ones.sum()
    off = results - level
    variance = off @ np.linalg.solve(covariance, off) / 40
    model = GaussianProcessRegressor(kernel, alpha=noise, optimizer=None).fit(known, off)
    with_others = GaussianProcessRegressor(kernel, alpha=noise, optimizer=None).fit(
        np.vstack((known, others)), np.append(off, model.predict(others))
    )
    mean, deviation = with_others.predict(asked, return_std=True)

    found = process.conditioned(known, results, others)(asked)
    np.testing.assert_allclose(found[0], mean + level, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found[1], deviation * math.sqrt(variance), rtol=1e-4, atol=1e-5)
