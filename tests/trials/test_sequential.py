"""A sequential test: its errors by exact sums and over many seeds, its boundaries, its runs."""

from __future__ import annotations

import dataclasses
import math

import falsify_samples as toy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.sample_size import plan_with_power
from taxinet_ros.trials.sequential import (
    Course,
    Decision,
    SequentialTest,
    StopCount,
    course,
    decision,
    operating,
    parse_stop_rule,
    parse_test,
    simulate,
)

TESTS = {
    'spread bets at 86 %': 'min-satisfaction=0.86',
    'designed for 95 %': 'min-satisfaction=0.86,design=0.95',
    'off the runway': 'max-off-runway=0.05,design=0.005,confidence=0.9',
    'rare': 'min-satisfaction=0.99,design=0.999',
}
MOST = 1500


def row(index: int, outcome: Outcome, **changes) -> RunRow:
    rho = {Outcome.PASS: {'phi': 0.5}, Outcome.FAIL: {'phi': -2.25}}.get(outcome, {})
    values = {
        'run_id': f'run-{index}', 'index': index, 'program': 's_falsif', 'seed': 1,
        'perception': 'original', **Scenario().to_human(),
        'robustness': exact_intervals(rho), 'left_runway': False if rho else None, **changes,
    }
    return RunRow(outcome=outcome, **values)


@pytest.mark.parametrize('text', TESTS.values(), ids=TESTS)
def test_given_a_system_at_the_limit_then_each_wrong_answer_is_as_rare_as_promised(text):
    test = parse_test(text)
    alpha = 1 - test.confidence
    at_limit = operating(test, test.limit, MOST)
    assert 0 < at_limit.passes <= alpha
    assert at_limit.fails <= alpha
    # Not so cautious that the promise means nothing; the spread bets leave the rest for later runs.
    assert at_limit.passes > 0.3 * alpha
    if test.design is not None:
        designed = operating(test, test.design, MOST)
        assert designed.below_design + designed.fails <= alpha + 0.005
        assert designed.passes + designed.open >= test.confidence - 0.005


@pytest.mark.parametrize('text', TESTS.values(), ids=TESTS)
@pytest.mark.parametrize('worse', [1.2, 2.0])
def test_given_a_worse_system_then_it_passes_more_rarely_still(text, worse):
    test = parse_test(text)
    at_limit = operating(test, test.limit, MOST)
    beyond = operating(test, worse * test.limit, MOST)
    assert beyond.passes < at_limit.passes
    assert beyond.mean_runs < at_limit.mean_runs


@pytest.mark.parametrize('text', list(TESTS.values())[:3], ids=list(TESTS)[:3])
def test_given_400_seeds_at_three_rates_then_they_end_as_the_sums_say(text):
    test = parse_test(text)
    most, seeds = 300, 400
    for truth in (test.limit / 2, test.limit, 1.5 * test.limit):
        exact = operating(test, truth, most)
        ended = [
            simulate(test, np.random.default_rng([seed, round(1e6 * truth)]).random(most) < truth)
            for seed in range(seeds)
        ]
        for found, expected in (
            (Decision.PASS, exact.passes), (Decision.FAIL, exact.fails),
            (Decision.BELOW_DESIGN, exact.below_design), (None, exact.open),
        ):
            number = sum(one is found for one, _ in ended)
            # Seeds are fixed, so this passes always or never; 36 such checks at 1e-4 each.
            assert binomtest(number, seeds, min(max(expected, 0), 1)).pvalue > 1e-4
        runs = np.array([number for _, number in ended])
        assert abs(runs.mean() - exact.mean_runs) < 4 * runs.std() / math.sqrt(seeds)


def test_given_the_probabilities_of_all_ends_then_they_are_one():
    for text in TESTS.values():
        found = operating(parse_test(text), 0.03, 400)
        total = found.passes + found.fails + found.below_design + found.open
        assert total == pytest.approx(1, abs=1e-12)


def test_given_a_designed_test_then_its_boundary_is_that_of_wald():
    test = parse_test('min-satisfaction=0.9,design=0.99')
    for runs in range(1, 400):
        for bad in range(min(runs, 12) + 1):
            ratio = (0.01 / 0.1) ** bad * (0.99 / 0.9) ** (runs - bad)
            found = decision(test, bad, runs)
            assert (found is Decision.PASS) == (ratio >= 20)
            if ratio <= 1 / 20:
                assert found in (Decision.BELOW_DESIGN, Decision.FAIL)


def test_given_no_failure_then_a_perfect_design_would_need_what_the_fixed_test_needs():
    # (1 / 0.999) ** n >= 20 has the solution 2,995 too: no test passes a flawless system sooner.
    test = SequentialTest(criterion='min-satisfaction', limit=0.001, design=1e-9)
    _, runs = simulate(test, np.zeros(4000, dtype=bool))
    assert runs == 2995


def test_given_a_clear_case_then_it_takes_half_the_runs_of_the_fixed_test():
    test = parse_test('min-satisfaction=0.86,design=0.95')
    fixed = plan_with_power(0.14, 0.95, 0.05, 0.95)
    assert fixed.runs == 109
    assert operating(test, 0.05, 2000).mean_runs < 0.7 * fixed.runs
    assert operating(test, 0.28, 2000).mean_runs < 0.2 * fixed.runs


@settings(max_examples=50, deadline=None)
@given(
    limit=st.floats(0.01, 0.6), ratio=st.floats(0.05, 0.8), designed=st.booleans(),
    confidence=st.floats(0.5, 0.99),
)
def test_given_any_test_then_its_boundaries_are_those_of_the_stakes(
    limit, ratio, designed, confidence
):
    test = SequentialTest(
        criterion='min-satisfaction', limit=limit, confidence=confidence,
        design=limit * ratio if designed else None,
    )
    for runs in (1, 2, 7, 40):
        for bad in range(runs + 1):
            good = runs - bad
            stakes = {
                Decision.PASS: test.log_pass(bad, good), Decision.FAIL: test.log_fail(bad, good),
                Decision.BELOW_DESIGN: test.log_below_design(bad, good),
            }
            enough = [one for one in Decision if stakes[one] >= test.enough]
            assert decision(test, bad, runs) is (enough[0] if enough else None)


@pytest.mark.parametrize('text', [*TESTS.values(), 'max-off-runway=0.25'])
def test_given_a_test_then_its_text_reads_back(text):
    assert str(parse_test(text)) == text
    assert str(parse_stop_rule(text)) == text


@pytest.mark.parametrize(('text', 'words'), [
    ('min-satisfaction=1', 'no number of runs can decide it'),
    ('max-off-runway=0', 'no number of runs can decide it'),
    ('min-satisfaction=0.9,design=0.8', 'design=0.8: needs to be better than the threshold 0.9'),
    ('min-satisfaction=0.9,design=1', 'not free of failures'),
    ('max-off-runway=0.1,design=0.2', 'design=0.2: needs to be better'),
    ('min-satisfaction=0.9,confidence=0.3', 'needs to be within 0.5..1'),
    ('min-satisfaction=many', "'many' is no number"),
    ('min-satisfaction=0.9,power=1', "'power=1': expected design=SHARE or confidence=SHARE"),
    ('min-satisfaction=0.9,design=0.95,design=0.96', 'each once'),
    ('min-satisfaction=0.9,design=nan', "'nan' is no number"),
])
def test_given_a_test_that_cannot_be_made_then_it_is_refused_by_name(text, words):
    with pytest.raises(UsageError) as refused:
        parse_stop_rule(text)
    assert words in str(refused.value)


def test_given_runs_then_they_count_in_their_order_and_the_first_decision_stands():
    test = parse_test('min-satisfaction=0.9')
    good = [row(index, Outcome.PASS) for index in range(60)]
    first = course(good, test)
    assert first.decision is Decision.PASS
    assert first.index is not None
    assert first.later == 60 - first.runs > 0
    # Later failures change nothing; the same failures earlier do.
    spoilt = [
        one if one.index <= first.index else row(one.index, Outcome.FAIL) for one in good
    ]
    assert course(reversed(spoilt), test) == first
    late = [row(index, Outcome.FAIL if index < 10 else Outcome.PASS) for index in range(60)]
    assert course(late, test).decision is Decision.FAIL


def test_given_a_gap_or_what_the_sampler_chose_then_it_does_not_count():
    test = parse_test('min-satisfaction=0.9')
    good = [row(index, Outcome.PASS) for index in range(60)]
    gap = [one for one in good if one.index != 5]
    assert course(gap, test) == Course(decision=None, runs=5, bad=0, index=None, later=0)
    chosen = [dataclasses.replace(one, sampler='ce', drawn=one.index % 3 == 0) for one in good]
    assert course(chosen, test).runs == 20
    assert course([dataclasses.replace(one, drawn=False) for one in chosen], test).runs == 0
    broken = [
        one if one.index != 5 else row(5, Outcome.INFRA_ERROR, kind='died') for one in good
    ]
    assert course(broken, test).decision is Decision.PASS
    assert course(broken, test).index == course(good, test).index + 1


def test_given_runs_stopped_too_early_then_the_runway_test_ends_there():
    test = parse_test('max-off-runway=0.1')
    rows = [row(index, Outcome.PASS) for index in range(60)]
    rows[7] = row(7, Outcome.PASS, left_runway=None)
    found = course(rows, test)
    assert (found.decision, found.runs, found.unknown) == (None, 7, 7)


OUTCOMES = (Outcome.PASS, Outcome.FAIL, Outcome.REJECTED, Outcome.INFRA_ERROR)


@pytest.mark.one_in(3)
@settings(max_examples=40, deadline=None)
@given(st.data())
@pytest.mark.parametrize('text', [
    'failures=3', 'half-width=0.2', 'min-satisfaction=0.7', 'max-off-runway=0.4',
    'min-satisfaction=0.7,design=0.9,confidence=0.7',
])
def test_given_runs_one_by_one_then_a_rule_is_met_as_by_a_walk_over_all_of_them(text, data):
    rule = parse_stop_rule(text)
    count, rows = StopCount(rule), []
    share = data.draw(st.sampled_from((0, 2, 9)))
    choices = [Outcome.PASS] * share + [*OUTCOMES] + [Outcome.FAIL] * (9 - share)
    for index in range(data.draw(st.integers(1, 40))):
        outcome = data.draw(st.sampled_from(choices))
        off = data.draw(st.sampled_from((False,) * share + (True, True, None))) \
            if outcome.judged else None
        drawn = data.draw(st.sampled_from((True, True, False, None)))
        kind = {'kind': 'died'} if outcome is Outcome.INFRA_ERROR else {}
        rows.append(row(index, outcome, drawn=drawn, left_runway=off, **kind))
        count.take(rows[-1])
        assert count.is_met == toy.is_met(rule, rows)
