"""Causes that were planted are named, those of noise hardly ever, and intervals hold the truth."""

from __future__ import annotations

import numpy as np
import pytest
from causes import Landscape, measure, searched

from taxinet_ros.analysis.causes.scan import SearchScan

pytestmark = pytest.mark.nightly


@pytest.mark.parametrize(('landscape', 'least'), [
    ('either, not both', 0.25), ('night over midnight', 0.25),
])
def test_t6_given_a_hundred_runs_then_causes_of_two_features_are_found_often(landscape, least):
    score = measure(landscape, 'random', 100, 8)
    assert score.named >= least * score.tables


@pytest.mark.parametrize('landscape', ['interaction, numbers'])
def test_t5_given_a_cause_that_was_picked_then_its_intervals_hold_the_truth(landscape):
    score = measure(landscape, 'random', 150, 6)
    assert np.mean(score.holds, axis=0).min() >= 0.85, score.holds
    assert np.mean(score.excess) > 0, 'picked for its rate, which is why the interval has to be'


@pytest.mark.parametrize('sampler', ['mab', 'ce', 'cmaes'])
def test_t4_given_a_search_of_nothing_when_looked_for_then_hardly_ever_a_cause_is_named(sampler):
    """A shuffling names one in 8 to 9 of 100 such tables, for the search went where it failed."""
    assert measure('no cause, 20 %', sampler, 60, 10).named <= 1


def test_in_a_search_too_a_feature_that_matters_is_told_from_one_that_does_not():
    """The sampler follows failures into some hours, so shuffled outcomes would not do."""
    hours = Landscape(rate=lambda t: np.where(t['time_of_day_h'] < 9, 0.7, 0.05))
    for seed in range(3):
        scan = SearchScan(searched('ce', 200, seed, hours).frame)
        rng = np.random.default_rng(0)
        assert scan.p_given('time_of_day_h', rng) > 0.05
        assert scan.p_given('heading_deg', rng) < 0.01
