"""Active search: rare failures, all regions of them, and failures that differ."""

from __future__ import annotations

import math

import numpy as np

from taxinet_ros.samplers.active_search import (
    PATIENCE,
    WINDOW,
    ActiveSearch,
    Features,
    GaussianProcess,
)
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.space import Dimension, Point, Space, prior_point

SPACE = Space((Dimension(name='x'), Dimension(name='kind', weights=(2, 1)), Dimension(name='y')))


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


def matern(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Covariance of smoothness 3/2 (Rasmussen and Williams 2006, equation 4.17)."""
    distance = math.sqrt(3) * np.linalg.norm(one[:, None] - other, axis=2)
    return (1 + distance) * np.exp(-distance)


def regression(
    known: np.ndarray, results: np.ndarray, noise: float, asked: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviation of a process of mean zero (the same, equations 2.25 and 2.26)."""
    between = matern(known, asked)
    weights = np.linalg.solve(matern(known, known) + noise * np.eye(len(known)), between)
    variance = 1 - (weights * between).sum(axis=0)
    return weights.T @ results, np.sqrt(variance)


def test_given_results_when_predicted_then_the_formulas_of_the_book_say_the_same() -> None:
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

    covariance = matern(known / scales, known / scales) + noise * np.eye(40)
    ones = np.linalg.solve(covariance, np.ones(40))
    level = ones @ results / ones.sum()
    off = results - level
    variance = off @ np.linalg.solve(covariance, off) / 40
    imagined, _ = regression(known / scales, off, noise, others / scales)
    mean, deviation = regression(
        np.vstack((known, others)) / scales, np.append(off, imagined), noise, asked / scales)

    found = process.conditioned(known, results, others)(asked)
    np.testing.assert_allclose(found[0], mean + level, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found[1], deviation * math.sqrt(variance), rtol=1e-4, atol=1e-5)
