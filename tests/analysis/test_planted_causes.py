"""Causes that were planted are found with their limits; in noise none is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planted_runs import planted_runs, planted_table
from scipy.stats import hypergeom

from taxinet_ros.analysis.causes import find_causes
from taxinet_ros.analysis.failure_region import Interval, Kinds
from taxinet_ros.analysis.scan_cells import interval_cells
from taxinet_ros.analysis.scan_statistic import hoeffding_bound, likelihood_ratio


def causes_of(tmp_path, rate, *, runs=2000, seed=1, **columns):
    return find_causes(planted_runs(planted_table(runs, seed, rate, **columns), tmp_path))


def part_of(cause, feature):
    parts = [part for part in cause.region.parts if part.feature == feature]
    assert len(parts) == 1, cause.region.words()
    return parts[0]


def test_given_a_crossing_when_looked_for_then_its_limits_are_found(tmp_path):
    found = causes_of(
        tmp_path, lambda t: np.where(t['distance_m'].between(1200, 1450), 0.8, 0.05)).found
    assert len(found) == 1
    (part,) = found[0].region.parts
    assert isinstance(part, Interval)
    assert (part.feature, part.low, part.high) == (
        'distance_m', pytest.approx(1200, abs=20), pytest.approx(1450, abs=20))
    assert found[0].inside.rate == pytest.approx(0.8, abs=0.08)
    assert found[0].inside.low < 0.8 < found[0].inside.high
    assert found[0].outside.rate == pytest.approx(0.05, abs=0.02)
    assert found[0].p < 0.001
    assert 'along the runway' in found[0].sentence()


def test_given_the_papers_shadow_when_looked_for_then_sky_and_hours_are_found_together(tmp_path):
    def rate(table):
        shadow = (table['clouds'] == 'clear') & table['time_of_day_h'].between(13.4, 15.5)
        return np.where(shadow, 0.67, 0.08)

    found = causes_of(tmp_path, rate, runs=4000).found
    assert len(found) == 1
    assert part_of(found[0], 'clouds') == Kinds(feature='clouds', kinds=('clear',))
    hours = part_of(found[0], 'time_of_day_h')
    assert (hours.low, hours.high) == (pytest.approx(13.4, abs=0.2), pytest.approx(15.5, abs=0.2))
    assert found[0].inside.rate == pytest.approx(0.67, abs=0.1)
    assert found[0].sentence().startswith('Between 13:')


def test_given_two_numeric_conditions_when_looked_for_then_both_are_found(tmp_path):
    def rate(table):
        return np.where((table['distance_m'] < 500) & (table['heading_deg'] > 10), 0.7, 0.05)

    found = causes_of(tmp_path, rate, runs=3000).found
    assert found
    distance, heading = (part_of(found[0], name) for name in ('distance_m', 'heading_deg'))
    assert (distance.low, distance.high) == (None, pytest.approx(500, abs=30))
    assert (heading.low, heading.high) == (pytest.approx(10, abs=2), None)


def test_given_a_kind_of_clouds_when_looked_for_then_it_alone_is_named(tmp_path):
    found = causes_of(
        tmp_path, lambda t: np.where(t['clouds'].isin(['broken', 'stratus']), 0.4, 0.1)).found
    assert [cause.region.parts for cause in found] == [
        (Kinds(feature='clouds', kinds=('broken', 'stratus')),)]


def test_given_an_offset_to_either_side_when_looked_for_then_no_side_is_blamed(tmp_path):
    found = causes_of(tmp_path, lambda t: np.where(t['heading_deg'].abs() > 22, 0.6, 0.05)).found
    assert len(found) == 1
    (part,) = found[0].region.parts
    assert (part.feature, part.low, part.high) == (
        'abs_heading_deg', pytest.approx(22, abs=1.01), None)


def test_given_a_switch_when_looked_for_then_it_is_named(tmp_path):
    shadows = np.arange(400) % 2 == 0
    found = causes_of(
        tmp_path, lambda t: np.where(t['shadows'], 0.5, 0.05), runs=400, shadows=shadows).found
    assert [cause.region.words() for cause in found] == ['with the shadow of the aircraft']


def test_given_several_causes_when_looked_for_then_the_greatest_comes_first(tmp_path):
    def rate(table):
        rain = table['rain_percent'] > 0
        crossing = table['distance_m'].between(1200, 1450)
        early = table['time_of_day_h'] < 7.5
        return np.where(rain, 0.95, np.where(crossing, 0.9, np.where(early, 0.5, 0.03)))

    causes = causes_of(tmp_path, rate, runs=4000)
    assert [cause.region.features[0].name for cause in causes.found] == [
        'rain_percent', 'distance_m', 'time_of_day_h']
    assert causes.found[0].region.words() == 'rain of 25 % or more'
    assert part_of(causes.found[2], 'time_of_day_h').high == pytest.approx(7.5, abs=0.2)
    explained = [cause.explained for cause in causes.found]
    assert explained == sorted(explained, reverse=True)
    assert causes.explained == pytest.approx(sum(explained))
    assert causes.rest.rate == pytest.approx(0.03, abs=0.01)


def test_given_noise_when_looked_for_then_hardly_ever_a_cause_is_named(tmp_path):
    named = [
        seed for seed in range(20)
        if causes_of(
            tmp_path, lambda t: np.full(len(t), 0.2), runs=200, seed=seed, cross_track_m=0.0,
        ).found
    ]
    assert len(named) <= 1, f'named causes of nothing with seeds {named}'


@pytest.mark.parametrize(('runs', 'failing', 'words'), [
    (12, 2, '12 runs, 2 failures: too few to name causes'),
    (300, 300, '300 runs, 300 failures: where all runs fail, nothing tells causes apart'),
    (300, 0, '300 runs, no failure: there are no causes to name'),
    (100, 98, '100 runs, 98 failures: too few others to tell causes apart'),
    (1, 1, '1 run, 1 failure: where all runs fail, nothing tells causes apart'),
])
def test_given_too_little_to_go_by_then_it_says_so(tmp_path, runs, failing, words):
    causes = causes_of(tmp_path, lambda t: t['index'] < failing, runs=runs)
    assert (causes.found, causes.why_not) == ((), words)


def test_given_features_that_do_not_vary_then_the_others_are_still_looked_at(tmp_path):
    found = causes_of(
        tmp_path, lambda t: np.where(t['time_of_day_h'] > 16, 0.8, 0.05), runs=300,
        clouds='clear', rain_percent=0.0, cross_track_m=0.0, distance_m=400.0, heading_deg=0.0,
    ).found
    assert [cause.region.features[0].name for cause in found] == ['time_of_day_h']
    nothing = causes_of(
        tmp_path, lambda t: np.full(len(t), 0.5), runs=100, clouds='clear', rain_percent=0.0,
        cross_track_m=0.0, distance_m=400.0, heading_deg=0.0, time_of_day_h=9.0,
    )
    assert nothing.found == ()


def test_given_the_same_runs_twice_then_the_same_is_found(tmp_path):
    def rate(table):
        return np.where(table['distance_m'] > 1700, 0.5, 0.1)

    first, second = (causes_of(tmp_path, rate, runs=500) for _ in range(2))
    assert first.found
    assert first == second


def test_given_runs_of_a_sampler_when_looked_for_then_rates_are_of_what_the_program_drew(tmp_path):
    table = planted_table(1000, 3, lambda t: np.where(t['distance_m'] < 500, 0.6, 0.05))
    # The sampler sought scenes near the threshold; of the others all were drawn.
    near = table['distance_m'] < 500
    drawn = ~near | (table['index'] % 3 == 0)
    found = find_causes(planted_runs(table.assign(sampler='ce', drawn=drawn), tmp_path)).found
    assert len(found) == 1
    failed = table['outcome'] == 'FAIL'
    share = (failed & near & drawn).sum() / (failed & drawn).sum()
    assert found[0].explained == pytest.approx(share, abs=0.03)
    assert share < (failed & near).sum() / failed.sum() - 0.1
    assert found[0].inside.effective == pytest.approx((near & drawn).sum(), abs=12)


@given(
    st.integers(5, 60), st.integers(0, 60), st.integers(1, 59), st.integers(0, 60),
)
def test_given_any_split_then_the_bound_is_not_below_the_true_probability(
    runs, failures, inside, within
):
    failures, inside = min(failures, runs), min(inside, runs - 1)
    within = min(within, failures, inside)
    beyond = failures - within
    if beyond > runs - inside:
        within, beyond = failures - (runs - inside), runs - inside
    failed = np.arange(inside) < within
    failed = np.concatenate([failed, np.arange(runs - inside) < beyond])
    exact = hypergeom.sf(within - 1, runs, failures, inside)
    bound = hoeffding_bound(failed, np.arange(runs) < inside)
    assert bound >= exact * (1 - 1e-9)


@given(st.integers(1, 50), st.integers(1, 50), st.data())
def test_given_counts_then_the_ratio_is_that_of_two_binomials(inside, outside, data):
    within, beyond = data.draw(st.integers(0, inside)), data.draw(st.integers(0, outside))

    def log_likelihood(k, n):
        return sum(count * np.log(count / n) for count in (k, n - k) if count)

    ratio = likelihood_ratio(
        np.array([within]), np.array([inside]), within + beyond, inside + outside)[0]
    denser = within * outside > beyond * inside
    expected = (
        log_likelihood(within, inside) + log_likelihood(beyond, outside)
        - log_likelihood(within + beyond, inside + outside)
    )
    assert ratio == pytest.approx(expected if denser else 0.0, abs=1e-9)


@given(st.lists(st.sampled_from([0.0, 0.0, 0.0, 1.0, 2.5, 7.0, 8.0, 30.0]), min_size=1,
                max_size=60), st.integers(1, 12))
def test_given_values_then_each_lies_in_its_own_cell(values, most):
    cells, places = interval_cells(np.array(values), most, 'distance_m')
    assert len(places) == len(values)
    assert all(cells[place].low <= value <= cells[place].high
               for place, value in zip(places, values, strict=True))
    ends = [end for cell in cells for end in (cell.low, cell.high)]
    assert ends == sorted(ends), 'cells do not overlap'
