"""Pairs of runs with their statistics, and the arms of an experiment: figures, words, pictures."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from scipy.stats import rankdata

from taxinet_ros.analysis.experiment.arms import PairedArms, paired_arms, pairs_frame
from taxinet_ros.analysis.experiment.pairs import PairedRates, paired_rates, paired_shift
from taxinet_ros.analysis.experiment.report import (
    experiment_json,
    experiment_report,
    range_words,
    title_of,
)
from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
from taxinet_ros.analysis.runs.campaign import holm
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.trials.experiment import Arm, Experiment
from taxinet_ros.trials.record.row import RunRow

COUNTS = st.integers(0, 40)
RATES = st.builds(PairedRates, both=COUNTS, only_first=COUNTS, only_second=COUNTS, neither=COUNTS)


def test_given_newcombes_example_then_the_interval_is_his():
    # Newcombe 1998 (paired), table II: a = 36, b = 12, c = 2, d = 0; method 10.
    found = PairedRates(both=36, only_first=2, only_second=12, neither=0).difference
    assert found.value == pytest.approx(0.2)
    assert (found.low, found.high) == (pytest.approx(0.0569, abs=5e-5),
                                       pytest.approx(0.3404, abs=5e-5))


@given(RATES)
def test_given_two_arms_when_exchanged_then_everything_is_mirrored(rates):
    other = PairedRates(both=rates.both, only_first=rates.only_second,
                        only_second=rates.only_first, neither=rates.neither)
    assert other.p_value == pytest.approx(rates.p_value, nan_ok=True)
    if rates.pairs:
        one, two = rates.difference, other.difference
        assert (two.value, two.low, two.high) == pytest.approx((-one.value, -one.high, -one.low))
        assert -1 - 1e-9 <= one.low <= one.value + 1e-9
        assert one.value <= one.high + 1e-9 <= 1 + 2e-9


@given(st.integers(0, 12), st.integers(0, 12), COUNTS)
def test_given_pairs_that_differ_then_the_test_counts_all_ways_that_are_as_uneven(one, other, same):
    total = one + other
    uneven = abs(one - other)
    ways = sum(math.comb(total, k) for k in range(total + 1) if abs(2 * k - total) >= uneven)
    rates = PairedRates(both=same, only_first=one, only_second=other, neither=same)
    expected = ways / 2**total if rates.pairs else math.nan
    assert rates.p_value == pytest.approx(expected, nan_ok=True)


def test_given_pairs_that_are_all_equal_then_zero_is_within_and_nothing_is_proven():
    rates = PairedRates(both=20, only_first=0, only_second=0, neither=20)
    assert (rates.difference.value, rates.p_value) == (0.0, 1.0)
    assert rates.difference.low < 0 < rates.difference.high
    assert math.isnan(PairedRates(both=0, only_first=0, only_second=0, neither=0).difference.low)


def test_given_yes_and_no_then_the_four_kinds_are_counted():
    first, second = zip(*product((True, False), repeat=2), strict=True)
    assert paired_rates(first, second) == PairedRates(
        both=1, only_first=1, only_second=1, neither=1)
    with pytest.raises(ValueError, match='shorter'):
        paired_rates([True], [])


def by_signs(differences: list[float]) -> float:
    """Wilcoxon's p value by trying all signs."""
    size = np.abs(differences)
    ranks = size.argsort().argsort() + 1
    found = ranks[np.array(differences) > 0].sum()
    sums = [sum(rank for rank, up in zip(ranks, signs, strict=True) if up)
            for signs in product((0, 1), repeat=len(size))]
    least = min(sum(one <= found for one in sums), sum(one >= found for one in sums))
    return min(2 * least / len(sums), 1.0)


@given(st.lists(st.integers(1, 10**6), min_size=3, max_size=9, unique=True), st.data())
def test_given_few_pairs_then_the_test_is_that_of_all_signs(sizes, data):
    signs = data.draw(st.lists(st.sampled_from((-1, 1)), min_size=9, max_size=9))
    differences = [float(s * size) for s, size in zip(signs, sizes, strict=False)]
    shift = paired_shift([0.0] * len(differences), differences)
    assert shift.p_value == pytest.approx(by_signs(differences))
    # The interval holds 0 if the test at 5 % does not speak against it.
    if not math.isnan(shift.change.low):
        assert (shift.change.low <= 0 <= shift.change.high) is (shift.p_value > 0.05)


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=11))
def test_signed_ranks_of_ties_and_unchanged_pairs_are_exact(differences):
    """By all signs of the pairs that changed, tied sizes sharing the mean of their ranks."""
    changed = np.array([one for one in differences if one])
    ranks = rankdata(np.abs(changed))
    centre = ranks.sum() / 2
    sums = np.array(list(product((0, 1), repeat=len(ranks)))) @ ranks
    expected = (np.abs(sums - centre) >= abs(ranks[changed > 0].sum() - centre) - 1e-9).mean()
    found = paired_shift([0.0] * len(differences), [float(one) for one in differences])
    assert found.p_value == pytest.approx(expected)


def test_given_growth_of_few_pairs_then_it_is_growth_though_the_typical_change_is_none():
    shift = paired_shift([0.0] * 60, [0.0] * 47 + [1.0] * 13)
    assert (shift.change.value, shift.grows) == (0.0, True)
    assert shift.p_value < 0.001
    assert not paired_shift([0.0] * 47 + [1.0] * 13, [0.0] * 60).grows


@pytest.mark.parametrize('unknown', range(5))
def test_given_unknown_pairs_then_no_result_of_theirs_leaves_a_greater_p_value(unknown):
    for first, second in product(range(1, 12), range(12)):
        rates = PairedRates(both=3, only_first=first, only_second=second, neither=2)
        greatest = max(
            dataclasses.replace(rates, only_first=first + one, only_second=second + other).p_value
            for one in range(unknown + 1) for other in range(unknown + 1 - one)
        )
        assert rates.p_at_most(unknown) == pytest.approx(greatest)


def test_five_of_fourteen_pairs_changed_one_way_are_not_significant():
    assert paired_shift([0.0] * 14, [0.0] * 9 + [1.0, 2.0, 3.0, 4.0, 5.0]).p_value == 0.0625


def test_given_many_small_and_few_great_changes_then_the_great_ones_count():
    # As with shadows: in the morning next to nothing, in the afternoon a lot.
    morning, afternoon = [-0.004 - 1e-5 * k for k in range(21)], [0.1 + 0.02 * k for k in range(19)]
    shift = paired_shift([1.0] * 40, [1.0 + change for change in (*morning, *afternoon)])
    assert (shift.more, shift.less) == (19, 21)
    assert shift.p_value < 0.05
    assert shift.change.low > 0


@pytest.mark.parametrize('count', [25, 90])
def test_given_samples_of_a_known_middle_then_95_of_100_intervals_hold_it(count):
    generator = np.random.default_rng(3)
    shifts = [paired_shift(np.zeros(count), generator.normal(1.0, 2.0, count)) for _ in range(400)]
    held = sum(shift.change.low <= 1.0 <= shift.change.high for shift in shifts)
    assert 0.925 < held / 400 < 0.98


def test_given_more_pairs_than_can_be_ranked_then_a_fair_share_of_them_is():
    shift = paired_shift(np.zeros(9000), np.random.default_rng(1).normal(0.5, 1.0, 9000))
    assert shift.pairs == 9000
    assert shift.change.low < 0.5 < shift.change.high < shift.change.low + 0.2


def test_given_figures_that_an_arm_does_not_have_then_the_pair_is_left_out():
    shift = paired_shift([1.0, math.nan, 2.0, 3.0], [2.0, 1.0, math.nan, 3.0])
    assert (shift.pairs, shift.more, shift.less) == (2, 1, 0)
    assert (shift.change.value, shift.p_value) == (0.5, 1.0)
    assert math.isnan(shift.change.low)
    assert math.isnan(paired_shift([], []).change.value)


def test_given_no_pair_then_no_p_value_is_stated():
    assert math.isnan(paired_shift([], []).p_value)
    assert math.isnan(paired_rates([], []).p_value)
    rates = experiment_json(found([None], [None]))['comparisons'][0]
    assert rates['satisfied']['mcnemar_p'] is None
    assert rates['rho']['wilcoxon_p'] is None


def test_given_runs_that_were_stopped_then_what_is_not_known_of_them_is_in_no_rate():
    on = [row(0, -1.0, shadows=True), row(1, -20.0, shadows=True), row(2, -1.0, shadows=True)]
    stopped = dataclasses.replace(
        row(1, -1.0, shadows=False), stopped_early=True, left_runway=None, settle_time_s=None)
    off = [row(0, 1.0, shadows=False), stopped, row(2, -20.0, shadows=False)]
    arms = paired_arms(ASKED, {'on': on, 'off': off})
    (one,) = arms.comparisons
    assert one.satisfied.pairs == 3
    assert one.off_runway == PairedRates(both=0, only_first=0, only_second=1, neither=1)
    assert one.settled == PairedRates(both=0, only_first=0, only_second=1, neither=1)
    words = ' '.join(experiment_report(arms).sentences)
    assert 'In 1 pairs a run was stopped before it was known' in words
    lines = experiment_report(arms).sections[0].tables[0].rows
    assert [line[4] for line in lines] == [1, None]


@pytest.mark.parametrize(('formula', 'unit', 'axis'), [
    ('always(abs(cte) <= 2)', ' m', ' [m]'), ('always(abs(he) <= 5 deg)', ' rad', ' [rad]'),
    ('always(speed <= 9)', ' m/s', ' [m/s]'), ('always(unusable_share <= 0.1)', '', ''),
    ('always(cte <= 2 and he <= 1)', '', ''), ('always(estimate_gap <= 2)', ' s', ' [s]'),
])
def test_given_a_formula_then_its_robustness_has_its_own_unit(formula, unit, axis):
    asked = dataclasses.replace(ASKED, specs=(f'own={formula}',))
    arms = dataclasses.replace(worse(), experiment=asked)
    words = ' '.join(experiment_report(arms).sentences)
    assert f'rho typically changes by +1.50{unit} (95' in words
    figure = Figure()
    experiment_report(arms).sections[1].pictures[0].draw(figure, LIGHT)
    assert figure.axes[0].get_ylabel() == f'change of ρ{axis}'
    figure = Figure()
    experiment_report(arms).sections[0].pictures[0].draw(figure, LIGHT)
    assert figure.axes[0].get_ylabel() == f'ρ of own{axis}'


ASKED = Experiment(
    name='shadows', program='p', runs=12, seed=0, sampler='halton', sampler_options={},
    specs=('phi_eventually',), overrides={}, over='', compare_to='on',
    arms=(Arm(name='on', perception='original'),
          Arm(name='off', perception='original', laid_over={'shadows': 'off'})),
)


def row(index: int, rho: float | None, *, shadows: bool, settled: bool = True) -> RunRow:
    scene = Scenario(time_of_day_s=(6 + index) * 3600.0, shadows=shadows)
    if rho is None:
        return RunRow(run_id=f'r-{index}', index=index, program='p', seed=0, perception='original',
                      outcome=Outcome.INFRA_ERROR, kind='died', **scene.to_human())
    return RunRow(
        run_id=f'r-{index}', index=index, program='p', seed=0, perception='original',
        outcome=Outcome.PASS if rho > 0 else Outcome.FAIL,
        robustness=exact_intervals({'phi_eventually': rho}),
        left_runway=rho < -10, max_cross_track_m=2.0 - rho,
        settle_time_s=4.0 if settled and rho > 0 else None, **scene.to_human(),
    )


def found(on: list[float | None], off: list[float | None]) -> PairedArms:
    return paired_arms(ASKED, {
        'on': tuple(row(index, rho, shadows=True) for index, rho in enumerate(on)),
        'off': tuple(row(index, rho, shadows=False) for index, rho in enumerate(off)),
    })


@functools.cache  # two seconds, which are not those of whoever only collects tests
def worse() -> PairedArms:
    return found([-1.0] * 7 + [-20.0] + [1.0] * 4, [0.5] * 8 + [1.0] * 4)


def test_given_two_arms_then_pairs_are_counted_by_scene():
    (one,) = worse().comparisons
    rates = one.satisfied
    assert (rates.both, rates.only_first, rates.only_second, rates.neither) == (4, 0, 8, 0)
    assert rates.p_value == pytest.approx(2 / 2**8)
    # The middle of 78 means: of 4 zeros, seven times 1.5 and once 20.5.
    assert one.rho.change.value == pytest.approx(1.5)
    assert (one.rho.more, one.rho.less) == (8, 0)
    assert (one.off_runway.first, one.off_runway.second) == (1, 0)
    assert (one.settled.first, one.settled.second, one.settle_time_s.pairs) == (4, 12, 4)
    assert (worse().over, worse().alone) == ('time_of_day_h', True)


def test_given_a_clear_difference_then_it_is_said_and_otherwise_not():
    words = ' '.join(experiment_report(worse()).sentences)
    assert words.startswith('Clearly more runs are satisfied in off than in on.')
    assert 'Of 12 scenes 4 satisfy phi_eventually in on (33 %) and 12 in off (100 %)' in words
    assert '+66.7 points (95 % interval' in words
    assert '8 are satisfied in off only, 0 in on only' in words
    equal = ' '.join(experiment_report(found([1.0, -1.0], [1.0, -1.0])).sentences)
    assert equal.startswith('No difference between on and off is proven.')
    shifted = ' '.join(experiment_report(found([0.5] * 9, [1.0] * 9)).sentences)
    assert shifted.startswith('Rho is greater in off than in on, but how many')


def test_given_p_values_of_a_family_then_holm_s_rule_adjusts_them_in_their_order():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.6, 0.9]) == holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([math.nan, 0.02]) == pytest.approx([math.nan, 0.04], nan_ok=True)
    assert holm([]) == []


@pytest.mark.nightly
def test_given_many_arms_without_an_effect_then_one_is_clear_in_five_per_cent_of_experiments():
    """Each against the base at its own 5 %: of eight such arms one was clear too often."""
    names = [f'arm{number}' for number in range(8)]
    asked = dataclasses.replace(ASKED, arms=(ASKED.arms[0], *(
        Arm(name=name, perception='original', laid_over={'shadows': 'off'}) for name in names)))
    told = raw = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        rhos = {name: np.where(rng.random(16) < 0.5, -1.0, 1.0) * rng.uniform(0.5, 1.5, 16)
                for name in ('on', *names)}
        many = paired_arms(asked, {
            name: tuple(row(index, float(rho), shadows=name == 'on')
                        for index, rho in enumerate(each)) for name, each in rhos.items()})
        told += any(one.rho_clear for one in many.comparisons)
        raw += any(one.rho.p_value < 0.05 for one in many.comparisons)
        assert all(one.satisfied_p >= one.satisfied.p_value for one in many.comparisons)
    assert told / 30 <= 0.12
    assert raw / 30 > 0.15, 'else the test could not tell'
    assert 'after Holm over 8 arms' in ' '.join(experiment_report(many).sentences)


def test_given_runs_that_were_not_judged_then_their_scenes_are_in_no_pair():
    some = found([1.0, None, 1.0], [1.0, 1.0])
    (one,) = some.comparisons
    assert (len(one.pairs), one.unpaired) == (1, 2)
    assert 'Runs of on without verdict, whose scenes are excluded: 1 INFRA_ERROR (1 died).' in [
        *experiment_report(some).sentences]


def test_given_runs_that_were_not_judged_then_nothing_is_clear_that_they_could_undo():
    certain = found([1.0] * 9, [-1.0] * 9).comparisons[0]
    open_ = found([1.0] * 9 + [None] * 3, [-1.0] * 9 + [1.0] * 3).comparisons[0]
    assert certain.clear
    assert not open_.clear
    assert open_.satisfied == certain.satisfied
    nothing = found([None], [None])
    assert 'no conclusion is possible' in ' '.join(experiment_report(nothing).sentences)


def test_given_files_of_this_machine_then_the_page_has_their_names_only():
    arms = tuple(
        dataclasses.replace(
            arm, perception='/home/me/mine.onnx', controller='/home/me/mine.py:steer')
        for arm in worse().experiment.arms
    )
    here = dataclasses.replace(worse().experiment, program='/home/me/scenes.scenic', arms=arms)
    report = experiment_report(dataclasses.replace(worse(), experiment=here))
    assert '/home' not in repr(report.facts)
    assert report.facts['program'] == 'scenes.scenic'
    assert 'perception mine.onnx, controller mine.py:steer' in report.facts['arm on']


def test_given_an_experiment_over_the_day_then_its_times_are_clock_times():
    assert title_of('time_of_day_h') == 'time of day'
    assert range_words('time_of_day_h', 6.0, 17.25) == 'time of day 06:00 to 17:15'
    assert range_words('heading_deg', -30.0, -2.5) == (
        'start heading, nose left −30.0 to −2.5°')


def test_given_an_experiment_then_report_json_and_table_hold_it():
    report = experiment_report(worse())
    arms, pairs = report.sections
    assert arms.tables[0].rows[0] == ('on', 12, 4, pytest.approx(100 / 3), 1, -1.0, 0)
    assert pairs.tables[0].rows[0][0] == 7
    assert len(pairs.tables[0].rows) == 8
    values = json.loads(json.dumps(experiment_json(worse()), allow_nan=False))
    assert values['comparisons'][0]['satisfied']['arm_only'] == 8
    assert values['arms']['off']['PASS'] == 12
    json.dumps(experiment_json(found([None], [None])), allow_nan=False)
    frame = pairs_frame(worse())
    assert len(frame) == 12
    assert list(frame['outcome_on']) == ['FAIL'] * 8 + ['PASS'] * 4
    assert frame['rho_off'].min() == 0.5
    image = png_bytes(arms.pictures[0], LIGHT)
    assert image == png_bytes(arms.pictures[0], LIGHT)
    assert len(png_bytes(experiment_report(found([None], [None])).sections[0].pictures[0],
                         LIGHT)) > 3000
