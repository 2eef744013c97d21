"""Pairs of runs in figures, against published examples and against counting."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.analysis.paired_rates import PairedRates, paired_rates, paired_shift

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
    assert other.p_value == pytest.approx(rates.p_value)
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
    assert rates.p_value == pytest.approx(ways / 2**total)


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
