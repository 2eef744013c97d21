"""Conformal lower bounds on synthetic runs whose distribution is known: coverage, over many seeds.

A run drifts, its outcome is the least distance to a limit; what is seen early tells it badly, late
well. Some runs jump, so outcomes have two modes.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.extras.forecast.conformal import fit, least_calibration_runs

MOMENTS = 6


def runs(random: np.random.Generator, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Features (R, T, 2) and outcomes (R,)."""
    slope = random.normal(0, 1, number)
    jumps = random.random(number) < 0.3
    path = np.cumsum(random.normal(0, 0.3, (number, MOMENTS)) + 0.3 * slope[:, None], axis=1)
    path[:, MOMENTS // 2:] -= 8 * jumps[:, None]
    noise = random.normal(0, 1, (number, MOMENTS))
    outcomes = path.min(axis=1) + random.normal(0, 0.2, number)
    return np.stack([path, noise], axis=2), outcomes


def covered(seed: int, confidence: float, number: int) -> float:
    """Share of new runs that are covered at all moments."""
    random = np.random.default_rng(seed)
    model = fit(*runs(random, number))
    features, outcomes = runs(random, 100)
    margin = model.margin(confidence)
    held = [
        model.bounds(features[:, moment], moment, margin) <= outcomes for moment in range(MOMENTS)
    ]
    return float(np.all(held, axis=0).mean())


@pytest.mark.nightly
@pytest.mark.parametrize(('confidence', 'number'), [(0.9, 60), (0.95, 100)])
def test_given_150_calibrations_then_new_runs_are_covered_as_often_as_the_ranks_say(
    confidence, number
):
    shares = np.array([covered(seed, confidence, number) for seed in range(150)])
    calibration = number // 2
    # The exact probability for continuous outcomes: rank / (n + 1).
    exact = math.ceil((calibration + 1) * confidence) / (calibration + 1)
    assert exact >= confidence
    error = shares.std() / math.sqrt(len(shares))
    assert 0.001 < error < 0.01  # it differs between calibrations, and has been measured
    assert abs(shares.mean() - exact) < 3.5 * error


def test_given_other_runs_than_calibrated_then_the_coverage_is_lost():
    """The guarantee is of exchangeable runs; this is what happens without."""
    random = np.random.default_rng(1)
    model = fit(*runs(random, 400))
    features, outcomes = runs(random, 400)
    margin = model.margin(0.9)
    held = [
        model.bounds(features[:, moment], moment, margin) <= outcomes - 3.0
        for moment in range(MOMENTS)
    ]
    assert np.all(held, axis=0).mean() < 0.5


def test_given_more_of_a_run_or_less_confidence_then_the_band_is_narrower():
    random = np.random.default_rng(2)
    model = fit(*runs(random, 400))
    margins = [model.margin(confidence) for confidence in (0.8, 0.9, 0.95)]
    assert margins == sorted(margins)
    assert margins[0] < margins[2]
    features, outcomes = runs(random, 200)
    late, early = (
        outcomes - model.bounds(features[:, moment], moment, margins[1])
        for moment in (MOMENTS - 1, 0)
    )
    assert np.median(late) < 0.3 * np.median(early)


def test_given_hopelessly_low_bounds_then_they_are_minus_infinity():
    random = np.random.default_rng(3)
    model = fit(*runs(random, 100))
    margin = model.margin(0.9) + 1000
    features, _ = runs(random, 3)
    assert (model.bounds(features[:, 0], 0, margin) == -np.inf).all()


def test_given_too_few_runs_then_it_says_how_many():
    random = np.random.default_rng(4)
    assert [least_calibration_runs(one) for one in (0.9, 0.95, 0.99)] == [9, 19, 99]
    with pytest.raises(UsageError, match='39 runs are too few'):
        fit(*runs(random, 39))
    with pytest.raises(UsageError, match='needs at least 99 calibration runs, not 20'):
        fit(*runs(random, 40)).margin(0.99)
    with pytest.raises(UsageError, match=r'within 0\.5\.\.1'):
        fit(*runs(random, 40)).margin(1.0)
