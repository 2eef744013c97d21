"""Optimisers behind our interface: Bayesian, Parzen estimator and evolution strategy."""

from __future__ import annotations

import logging
import math

import numpy as np
import optuna
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.samplers.optuna_study import finite, in_window
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.space import Dimension, Point

SPACE = (Dimension(name='x'), Dimension(name='y'), Dimension(name='kind', weights=(3, 1)))


def bowl(point: Point) -> float:
    """Lowest, at -0.2, only with the second kind: a quarter of the prior."""
    x, y, kind = point
    return (x - 0.31) ** 2 + (y - 0.64) ** 2 + (0.2 if SPACE[2].bin(kind) == 0 else 0.0) - 0.2


def search(name: str, seed: int, runs: int, rho=bowl, **options) -> list[Point]:
    sampler = make_sampler(name, SPACE, seed, runs, **options)
    points = []
    for _ in range(runs):
        index, point = sampler.next()
        points.append(point)
        sampler.tell(index, rho(point))
    return points


def lowest(points: list[Point]) -> float:
    return min(map(bowl, points)) + 0.2


@pytest.mark.nightly
@pytest.mark.parametrize(('name', 'runs'), [
    ('bo', 40), ('tpe', 100), ('cmaes', 200),
])
def test_given_a_bowl_when_an_optimiser_searches_then_it_gets_lower_than_chance(
    name: str, runs: int
) -> None:
    seeds = range(1) if name == 'bo' else range(3)
    by_chance = np.median([lowest(search('random', seed, runs)) for seed in range(9)])
    found = np.median([lowest(search(name, seed, runs, floor=0)) for seed in seeds])
    assert found < 0.4 * by_chance


@pytest.mark.parametrize('name', ['bo', 'tpe', 'cmaes'])
def test_given_broken_runs_when_an_optimiser_searches_then_it_does_without_them(name: str) -> None:
    runs = 22 if name == 'bo' else 100
    points = search(
        name, 1, runs, rho=lambda point: None if point[1] > 0.7 else bowl(point),
        **({} if name == 'cmaes' else {'startup': 6}),
    )
    assert len(points) == runs
    assert sum(point[1] > 0.7 for point in points) >= 1
    assert np.mean([bowl(point) for point in points[-8:]]) < np.mean([bowl(p) for p in points[:8]])


def test_given_an_optimiser_when_used_then_its_log_is_left_as_it_was(
    capfd: pytest.CaptureFixture[str],
) -> None:
    before = optuna.logging.get_verbosity()
    search('tpe', 0, 30)
    search('cmaes', 0, 30)
    assert optuna.logging.get_verbosity() == before == logging.INFO
    captured = capfd.readouterr()
    assert captured.out == captured.err == ''


def test_given_infinite_robustness_when_told_then_bayes_goes_on() -> None:
    points = search(
        'bo', 0, 16, rho=lambda point: math.inf if point[0] > 0.8 else bowl(point), startup=4
    )
    assert len(set(points)) == 16
    assert finite([1, -math.inf, 3, math.inf]) == [1, 1, 3, 3]
    assert finite([math.inf]) == [0]


def test_given_more_results_than_the_window_when_fitted_then_best_and_latest_stay() -> None:
    results = {index: float(abs(index - 20)) for index in range(0, 60, 2)}
    chosen = in_window(results, 7)
    assert chosen == [18, 20, 22, 52, 54, 56, 58]
    assert in_window(results, 100) == list(results)
    assert in_window({4: 1.0, 5: 2.0}, 10) == [4, 5]


@given(st.permutations(range(30)), st.integers(2, 40))
def test_given_results_that_came_in_any_order_then_the_window_holds_each_once(
    order: list[int], window: int,
) -> None:
    """The program's own draws get their numbers late, so the order is not that of the numbers."""
    results = {number: float(number % 7) for number in order}
    chosen = in_window(results, window)
    assert len(set(chosen)) == len(chosen) == min(window, 30)
    assert set(order[-(window - window // 2):]) <= set(chosen), 'the latest'
