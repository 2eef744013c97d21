"""How many runs a claim takes, against the binomial distribution itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom

from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import share_bounds
from taxinet_ros.trials.sample_size import (
    fewest_runs,
    further_runs,
    plan_with_power,
)


@pytest.mark.parametrize(('limit', 'confidence', 'runs'), [
    (0.001, 0.95, 2995), (0.01, 0.95, 299), (0.1, 0.95, 29), (0.05, 0.99, 90), (1e-6, 0.9, 2302584),
])
def test_given_no_failure_then_it_is_the_rule_of_three(limit, confidence, runs):
    assert fewest_runs(limit, confidence) == runs
    assert runs == math.ceil(math.log(1 - confidence) / math.log1p(-limit))


@pytest.mark.parametrize('failures', [0, 1, 5, 40])
@pytest.mark.parametrize('limit', [0.003, 0.14, 0.6])
def test_given_allowed_failures_then_one_run_less_would_not_do(failures, limit):
    runs = fewest_runs(limit, 0.95, failures)
    assert binom.cdf(failures, runs, limit) <= 0.05 < binom.cdf(failures, runs - 1, limit)
    assert share_bounds(failures, runs - failures, 0.05)[1] <= limit
    assert share_bounds(failures, runs - 1 - failures, 0.05)[1] > limit


def test_given_a_wanted_chance_then_no_plan_with_fewer_failures_reaches_it():
    found = plan_with_power(0.14, 0.95, 0.05, 0.9)
    assert found.chance == pytest.approx(binom.cdf(found.failures, found.runs, 0.05))
    assert found.chance >= 0.9
    for failures in range(found.failures):
        assert binom.cdf(failures, fewest_runs(0.14, 0.95, failures), 0.05) < 0.9


def test_given_an_extended_campaign_then_1000_of_them_claim_wrongly_in_5_per_cent_at_most():
    """Whoever has seen 200 runs, plans the rest by them and goes on, errs no more often."""
    limit, claims = 0.03, 0
    random = np.random.default_rng(3)
    for _ in range(1000):
        failed = random.binomial(200, limit)
        if failed > 6:
            continue  # gives up on a bad start, as somebody would
        more = further_runs(200, failed, limit, 0.95, 1)
        claims += more is not None and random.binomial(more, limit) <= 1
    assert 0 < claims <= 50


def test_given_enough_already_then_no_further_run_is_needed():
    assert further_runs(4000, 0, 0.01, 0.95, 0) == 0
    assert further_runs(4000, 6, 0.001, 0.95, 0) > 4000


@pytest.mark.parametrize(('call', 'words'), [
    (lambda: fewest_runs(0, 0.95), 'no number of runs shows that'),
    (lambda: fewest_runs(1, 0.95), 'it claims nothing'),
    (lambda: fewest_runs(0.1, 0.2), 'confidence 0.2'),
    (lambda: fewest_runs(0.1, 0.95, -1), 'failures -1'),
    (lambda: fewest_runs(1e-12, 0.95), 'takes more than 1,000,000,000 runs'),
    (lambda: plan_with_power(0.1, 0.95, 0.1, 0.9), 'does not meet the claim'),
    (lambda: plan_with_power(0.1, 0.95, 0.01, 1), 'power 1'),
    (lambda: plan_with_power(0.05, 0.95, 0.0499, 0.9), 'too close to the claim'),
])
def test_given_what_cannot_be_planned_then_it_is_refused_by_name(call, words):
    with pytest.raises(UsageError) as refused:
        call()
    assert words in str(refused.value)
