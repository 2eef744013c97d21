"""A system against its baseline: no worse, worse, or not known, with errors as stated."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pandas as pd
import pytest
from scipy.stats import multinomial

from taxinet_ros.analysis.experiment.pairs import PairedRates
from taxinet_ros.analysis.gate.baseline import (
    against_baseline,
    further_scenes,
    loss_of,
    loss_verdict,
)
from taxinet_ros.analysis.gate.criteria import Kind, Verdict
from taxinet_ros.errors import UsageError

BAGS = Path(__file__).resolve().parents[3] / 'bags'
GENERIC, SPECIALISED, TRUTH = (
    BAGS / f's_falsif_{name}_400.parquet' for name in ('generic', 'specialised', 'truth'))


def pairs(number: int, worse: int, better: int) -> PairedRates:
    return PairedRates(
        both=number - worse - better, only_first=worse, only_second=better, neither=0)


def verdict(number: int, worse: int, better: int, *, unknown: int = 0, margin: float = 0.05):
    return loss_verdict(loss_of(pairs(number, worse, better), unknown, 0.95), margin, 0.95)


def test_given_five_scenes_that_all_got_worse_then_it_is_proven_and_with_four_not():
    # 1/2 ** 5 < 0.05 < 1/2 ** 4
    assert verdict(100, 5, 0) is Verdict.FAIL
    assert verdict(100, 4, 0) is Verdict.INCONCLUSIVE
    assert loss_of(pairs(100, 5, 0), 0, 0.95).p_value == pytest.approx(1 / 32)


def test_given_no_change_then_it_takes_72_scenes_to_rule_out_five_points():
    # 0.95 ** 72 < 0.025 < 0.95 ** 71
    assert verdict(72, 0, 0) is Verdict.PASS
    assert verdict(71, 0, 0) is Verdict.INCONCLUSIVE
    assert further_scenes(pairs(71, 0, 0), 0.05, 0.95) == 1


def test_given_a_proven_loss_that_is_within_the_margin_then_it_passes_and_without_margin_fails():
    assert verdict(2000, 20, 2) is Verdict.PASS
    assert verdict(2000, 20, 2, margin=0.0) is Verdict.FAIL


def test_given_runs_without_a_verdict_then_they_are_never_a_pass_nor_a_failure():
    assert verdict(72, 0, 0, unknown=3) is Verdict.INCONCLUSIVE
    assert verdict(100, 5, 0, unknown=1) is Verdict.INCONCLUSIVE
    assert verdict(100, 9, 0, unknown=1) is Verdict.FAIL
    assert further_scenes(pairs(72, 0, 0), 0.05, 0.95) == 0
    assert loss_of(pairs(0, 0, 0), 0, 0.95) == (0.0, -1.0, 1.0, 1.0)


@pytest.mark.parametrize(('worse', 'better'), [(0.1, 0.1), (0.02, 0.02), (0.3, 0.3), (0.0, 0.1)])
def test_given_a_system_without_a_loss_then_it_fails_as_seldom_as_stated(worse, better):
    chance = answers(40, worse, better, margin=0.05)
    assert chance[Verdict.FAIL] <= 0.05


@pytest.mark.parametrize(('worse', 'better'), [(0.151, 0.0), (0.2, 0.049), (0.3, 0.149)])
def test_given_a_loss_beyond_the_margin_then_it_passes_as_seldom_as_stated(worse, better):
    chance = answers(40, worse, better, margin=0.15)
    assert chance[Verdict.PASS] <= 0.05
    assert sum(chance.values()) == pytest.approx(1, abs=1e-4)


def answers(number: int, worse: float, better: float, margin: float) -> dict[Verdict, float]:
    """Probability of each verdict, summed over all outcomes: exact."""
    chance = dict.fromkeys(Verdict, 0.0)
    counts = [
        (b, c, number - b - c) for b, c in itertools.product(range(number + 1), repeat=2)
        if b + c <= number
    ]
    law = multinomial(number, [worse, better, 1 - worse - better])
    for (b, c, _), p in zip(counts, law.pmf(counts), strict=True):
        if p > 1e-8:
            chance[verdict(number, b, c, margin=margin)] += float(p)
    return chance


def test_given_any_counts_then_the_loss_is_within_bounds_that_mirror():
    for number, worse, better in ((30, 0, 0), (30, 7, 2), (50, 1, 40), (9, 9, 0)):
        found, mirrored = (
            loss_of(pairs(number, *counts), 0, 0.9) for counts in (
                (worse, better), (better, worse)))
        assert found.low <= found.share <= found.high
        assert (mirrored.low, mirrored.high) == pytest.approx((-found.high, -found.low))
        wider = loss_of(pairs(number, worse, better), 2, 0.9)
        assert wider.low <= found.low
        assert found.high <= wider.high


@pytest.mark.filterwarnings('ignore')
def test_given_two_recorded_networks_then_the_scenes_that_got_worse_are_named():
    found = against_baseline(pd.read_parquet(SPECIALISED), SPECIALISED, GENERIC)
    assert (len(found.worse), len(found.better), found.unknown) == (5, 13, 0)
    one = found.criterion(0.05, 0.95, 'taxinet compare a b')
    assert (one.verdict, one.kind) == (Verdict.PASS, Kind.BASELINE)
    assert 'in 372 of 400 scenes, by the baseline in 364: 5 got worse, 13 better' in one.sentence
    assert 'p = 0.98 (McNemar, one side)' in one.sentence
    assert one.against == {changed.run_id for changed in found.worse}
    for changed in found.worse:
        assert changed.rho <= 0 < changed.baseline_rho
    falls = [changed.baseline_rho - changed.rho for changed in found.worse]
    assert falls == sorted(falls, reverse=True)
    strict = found.criterion(0.0, 0.95, '')
    assert strict.verdict is Verdict.INCONCLUSIVE
    assert 'more scenes needed' in strict.sentence


@pytest.mark.one_in(3)
@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize(('change', 'words'), [
    ({'program': 'other'}, 'its program is s_falsif, here other'),
    ({'seed': 3}, 'its seed is 0, here 3'),
    ({'sampler': 'active'}, 'here active'),
    ({'place': 'bikf_10'}, 'is another scene than s_falsif-s0-00000: place is kmwh_04, here bikf'),
    ({'distance_m': 7.5}, 'distance_m is'),
    ({'outcome': 'REJECTED'}, 'no run was judged'),
])
def test_given_other_scenes_then_what_they_differ_in_is_named(change, words):
    frame = pd.read_parquet(TRUTH).iloc[:20]
    with pytest.raises(UsageError) as refused:
        against_baseline(frame.assign(**change), TRUTH, TRUTH)
    assert words in str(refused.value)


@pytest.mark.filterwarnings('ignore')
def test_given_broken_runs_then_their_scenes_are_unknown():
    frame = pd.read_parquet(TRUTH).iloc[:80].reset_index(drop=True)
    rho = [name for name in frame.columns if str(name).startswith('rho')]
    frame.loc[[3, 4], rho] = math.nan
    frame.loc[[3, 4], 'outcome'] = 'INFRA_ERROR'
    found = against_baseline(frame, TRUTH, TRUTH)
    assert (found.unknown, len(found.found.scenes)) == (2, 78)
    assert '322 judged runs of the baseline have no counterpart' in found.notes
    one = found.criterion(0.05, 0.95, '')
    assert one.verdict is Verdict.INCONCLUSIVE
    assert '2 more are unknown' in one.sentence
    assert 'the runs without a verdict leave it open' in one.sentence


@pytest.mark.filterwarnings('ignore')
def test_given_scenes_that_a_sampler_chose_then_no_test_is_valid():
    frame = pd.read_parquet(TRUTH).iloc[:90].assign(sampler='ce', drawn=False)
    found = against_baseline(frame, TRUTH, TRUTH, again=True)
    one = found.criterion(0.05, 0.95, '')
    assert one.verdict is Verdict.INCONCLUSIVE
    assert 'no test is valid: the sampler ce chose the scenes' in one.sentence
