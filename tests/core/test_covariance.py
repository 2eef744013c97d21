"""What an estimate claims of its errors: from a user's answer to signal, statistics and alarm."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.bag.run.message_values import error_of
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.topics import ESTIMATE
from taxinet_ros.core.assurance.monitor import Seen, check_monitor, make_monitor
from taxinet_ros.core.assurance.switch import named_parts
from taxinet_ros.core.perception.perception import make_perception, read_estimate
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import UNKNOWN_COVARIANCE, TaxiCommand, TrackingError
from taxinet_ros.core.user_code import UserCodeError
from taxinet_ros.core.verdict.run_statistics import RunStatisticsCollector
from taxinet_ros.errors import UsageError

GOOD = (0.25, 0.004, 0.004, 0.0004)
FORMER = Path(__file__).parents[1] / 'bag' / 'genuine' / 'plain-00000'
"""A bag from before there were covariances."""


@pytest.mark.parametrize('claimed', [
    GOOD, list(GOOD), np.array(GOOD, np.float32).astype(float), np.array(GOOD).reshape(2, 2),
    [[0.25, 0.004], [0.004, 0.0004]],
])
def test_given_a_third_value_then_it_is_the_covariance(claimed):
    estimate = read_estimate((1.0, 0.1, claimed))
    assert estimate.covariance == pytest.approx(GOOD)
    assert estimate.cte_sigma_m == pytest.approx(0.5)
    assert estimate.he_sigma_rad == pytest.approx(0.02)
    assert estimate.covariance_flaw == ''


def test_given_no_variance_then_it_is_unknown():
    assert read_estimate((1.0, 0.1)).covariance == UNKNOWN_COVARIANCE
    half = TrackingError(cte_m=1.0, he_rad=0.1, covariance=(0.25, 0.0, 0.0, 0.0))
    assert (half.cte_sigma_m, half.covariance_flaw) == (0.5, '')
    assert math.isnan(half.he_sigma_rad)


@pytest.mark.parametrize(('claimed', 'why'), [
    ((0.25, 0.0, 0.0, math.nan), 'not finite'),
    ((math.inf, 0.0, 0.0, 1.0), 'not finite'),
    ((-0.25, 0.0, 0.0, 1.0), 'a variance is negative'),
    ((0.25, 0.1, 0.0, 1.0), 'not symmetric'),
    ((0.25, 0.6, 0.6, 1.0), 'an eigenvalue is negative'),
    ((0.0, 0.1, 0.1, 1.0), 'not symmetric|an eigenvalue is negative'),
    ((0.1, 0.2), 'expected 2 x 2 or 4 numbers'),
    (0.3, 'expected 2 x 2 or 4 numbers'),
    ('wide', 'expected 2 x 2 or 4 numbers'),
])
def test_given_no_covariance_as_such_then_it_is_refused_by_name(claimed, why, tmp_path):
    with pytest.raises(UsageError, match=why):
        read_estimate((1.0, 0.1, claimed))
    file = tmp_path / 'mine.py'
    file.write_text(f'from math import inf, nan\ndef look(image): return 1.0, 0.1, {claimed!r}')
    with pytest.raises(UserCodeError, match=why):
        make_perception(f'{file}:look').estimate(np.zeros((200, 360, 3), np.uint8), None)


def test_given_an_unusable_estimate_then_its_covariance_is_not_looked_at():
    estimate = TrackingError(cte_m=math.nan, he_rad=0.0, covariance=(math.nan, 0, 0, 0))
    assert estimate.covariance_flaw == ''


def test_given_claims_then_the_share_of_errors_within_them_is_known():
    collector = RunStatisticsCollector()
    for seq, (off, sigma) in enumerate(((0.4, 0.5), (0.6, 0.5), (1.5, 0.5), (9.0, math.nan))):
        collector.push(seq * 10**8, {
            'cte': 0.0, 'he': 0.0, 'cte_estimate': off, 'he_estimate': 0.0, 'cte_sigma': sigma,
        })
    found = collector.statistics.cte_error
    assert (found.sigma_max, found.within_1_sigma, found.within_2_sigma) == (0.5, 1 / 3, 2 / 3)
    assert math.isnan(collector.statistics.he_error.sigma_max)


def unsure(truth):
    """Claims 0.5 m, and in the second half 2 m."""
    sigma_m = 0.5 if truth.cte_m > 0.5 else 2.0
    return truth.cte_m, truth.he_rad, [[sigma_m**2, 0.0], [0.0, 1e-4]]


unsure.needs_image = False
SCENE = Scenario(cross_track_m=3.0, distance_m=700.0, duration_s=8.0)


def test_given_claims_then_formulas_and_trace_read_them():
    run = tx.run(SCENE, perception=unsure, specs='always(cte_sigma <= 0.75 m)')
    assert run.outcome is tx.Outcome.FAIL
    assert next(iter(run.rho.values())).lower == -1.25
    assert set(run.trace['est_cte_sigma_m']) == {0.5, 2.0}
    assert run.trace.attrs['units']['est_he_sigma_rad'] == 'rad'
    assert tx.robustness('always(cte_sigma <= 0.75 m)', run.trace) == -1.25
    plain = tx.run(SCENE, perception='truth')
    assert 'est_cte_sigma_m' not in plain.trace


def test_given_the_sigma_monitor_then_what_stays_beyond_its_limit_is_an_alarm():
    monitor = make_monitor('sigma:1.5')
    assert monitor.fingerprint == check_monitor('sigma:1.5') != check_monitor('sigma:2')
    assert named_parts('steering+sigma:1.5+stop')

    def scores(*sigmas):
        monitor.begin(SCENE)
        return [monitor.scores(Seen(
            image=np.zeros((200, 360, 3), np.uint8),
            estimate=TrackingError(cte_m=0.0, he_rad=0.0, covariance=(sigma**2, 0, 0, 0)),
            command=TaxiCommand(steering_rad=0.0, speed_mps=5.0),
        ))['uncertain'] for sigma in sigmas]

    assert scores(*[3.0] * 5) == [0, 0, 0, 0, pytest.approx(2.0)]
    assert scores(*[1.5] * 5)[-1] < 1, 'the limit itself is none'
    assert scores(3.0, 3.0, 3.0, 3.0, 1.0, 3.0)[-1] < 1, 'one below it begins anew'
    assert scores(*[0.0] * 5)[-1] == math.inf, 'who claims nothing may be off by anything'
    for word in ('sigma:0', 'sigma:-1', 'sigma:nan', 'sigma:', 'sigma:wide'):
        with pytest.raises(UsageError, match='needs a limit above 0 m'):
            make_monitor(word)


def test_given_a_bag_from_before_then_its_estimates_claim_nothing_and_all_else_is_read():
    recording = open_recording(FORMER)
    topic = next(one for one in recording.info.topics if one.name == f'/{ESTIMATE}')
    assert 'covariance' not in topic.definition
    estimates = [error_of(message) for _, _, message in recording.messages((ESTIMATE,))]
    assert len(estimates) == 31
    assert {estimate.covariance for estimate in estimates} == {UNKNOWN_COVARIANCE}
    assert 'est_cte_sigma_m' not in recording.columns
    assert recording.judge('phi_always').verdict == 'SATISFIED'
