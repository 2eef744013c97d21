"""Dryden's turbulence: variance, scale length and correlation against the formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest

from taxinet_ros.core.motion.gusts import SCALE_LENGTH_M, Gusts

SIGMA_MPS = 2.0
RUNS = 2000
WAYS_M = (0.0, 2.0, 10.0, 23.0, 60.0)
"""From the first sample on, gone in so many steps of unequal length."""


def samples() -> np.ndarray:
    """Gusts of many seeds, which are independent: (seeds, ways, along and across)."""
    found = np.empty((RUNS, len(WAYS_M), 2))
    for seed in range(RUNS):
        gusts, gone_m = Gusts(SIGMA_MPS, seed), 0.0
        for number, way_m in enumerate(WAYS_M):
            steps = 1 + 2 * number
            for _ in range(steps):
                gusts.advance((way_m - gone_m) / steps)
            gone_m = way_m
            found[seed, number] = gusts.along_mps, gusts.across_mps
    return found


@pytest.fixture(scope='module')
def found() -> np.ndarray:
    return samples()


def assert_mean(values: np.ndarray, expected: float) -> None:
    """Within four standard errors, which the values tell themselves."""
    error = values.std(ddof=1) / math.sqrt(len(values))
    assert abs(values.mean() - expected) < 4 * error


def test_given_the_least_height_of_the_specification_then_its_scale_length_is_ours():
    assert pytest.approx(23.05, abs=0.01) == SCALE_LENGTH_M
    # 75.6 ft, read off figure 10 of MIL-F-8785C as well as it can be.
    assert pytest.approx(75.6, abs=0.1) == SCALE_LENGTH_M / 0.3048


@pytest.mark.parametrize('place', range(len(WAYS_M)))
def test_given_many_seeds_then_mean_and_variance_are_those_asked_for_all_the_way(found, place):
    for component in (0, 1):
        assert_mean(found[:, place, component], 0.0)
        assert_mean(found[:, place, component] ** 2, SIGMA_MPS**2)
    assert_mean(found[:, place, 0] * found[:, place, 1], 0.0)


@pytest.mark.parametrize('place', range(1, len(WAYS_M)))
def test_given_a_way_through_the_air_then_the_correlation_is_drydens(found, place):
    reach = WAYS_M[place] / SCALE_LENGTH_M
    along, across = math.exp(-reach), math.exp(-reach) * (1 - reach / 2)
    products = found[:, 0] * found[:, place] / SIGMA_MPS**2
    assert_mean(products[:, 0], along)
    assert_mean(products[:, 1], across)
    assert_mean(found[:, 0, 0] * found[:, place, 1], 0.0)


def test_given_a_seed_then_the_gusts_are_the_same_again_and_those_of_another_are_not():
    def way(seed: int) -> list[float]:
        gusts, passed = Gusts(1.0, seed), []
        for _ in range(20):
            gusts.advance(0.05)
            passed += [gusts.along_mps, gusts.across_mps]
        return passed

    assert way(3) == way(3) != way(4)


def test_given_twice_the_strength_then_the_gusts_are_twice_as_strong():
    weak, strong = Gusts(1.0, 5), Gusts(2.0, 5)
    for _ in range(10):
        weak.advance(0.3)
        strong.advance(0.3)
        assert strong.along_mps == 2 * weak.along_mps
        assert strong.across_mps == pytest.approx(2 * weak.across_mps)


def test_given_no_way_through_the_air_then_the_gust_stays():
    gusts = Gusts(1.0, 5)
    before = gusts.along_mps, gusts.across_mps
    gusts.advance(0.0)
    assert (gusts.along_mps, gusts.across_mps) == before
