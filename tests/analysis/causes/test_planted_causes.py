"""Causes that were planted are found with their limits; in noise none is.

A cause's program draws scenes of the cause, and nothing else.
"""

from __future__ import annotations

import itertools
import json
import re
import shlex
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_runs import planted_runs, planted_table
from scipy.stats import hypergeom

from taxinet_ros.analysis.causes.causes import Cause, FoundRate, find_causes, round_limits
from taxinet_ros.analysis.causes.program import (
    cause_program,
    confirmation_command,
    program_name,
    why_no_program,
    write_scenes_program,
)
from taxinet_ros.analysis.causes.region import (
    Either,
    Interval,
    Kinds,
    Region,
    Slant,
    interval_cells,
    part_of,
)
from taxinet_ros.analysis.causes.scan import (
    Scan,
    hoeffding_bound,
    likelihood_ratio,
    log_evidence,
)
from taxinet_ros.analysis.runs.campaign import runs_of
from taxinet_ros.core.place import catalogue
from taxinet_ros.core.scenario_fields import SHORT_FORMS
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.source import SceneSource, sample_scenarios
from taxinet_ros.trials.record.table import read_table

pytestmark = pytest.mark.nightly

SHIPPED = Path(__file__).parents[3] / 'bags' / 's_falsif_original_4000.parquet'


def causes_of(tmp_path, rate, *, runs=2000, seed=1, **columns):
    return find_causes(planted_runs(planted_table(runs, seed, rate, **columns), tmp_path))


def part_about(cause, feature):
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
    assert 'along the track' in found[0].region.words()


def test_given_the_papers_shadow_when_looked_for_then_sky_and_hours_are_found_together(tmp_path):
    def rate(table):
        shadow = (table['clouds'] == 'clear') & table['time_of_day_h'].between(13.4, 15.5)
        return np.where(shadow, 0.67, 0.08)

    found = causes_of(tmp_path, rate, runs=4000).found
    assert len(found) == 1
    assert part_about(found[0], 'clouds') == Kinds(feature='clouds', kinds=('clear',))
    hours = part_about(found[0], 'time_of_day_h')
    assert (hours.low, hours.high) == (pytest.approx(13.4, abs=0.2), pytest.approx(15.5, abs=0.2))
    assert found[0].inside.rate == pytest.approx(0.67, abs=0.1)
    assert found[0].region.words().startswith('between 13:')


def test_given_two_numeric_conditions_when_looked_for_then_both_are_found(tmp_path):
    def rate(table):
        return np.where((table['distance_m'] < 500) & (table['heading_deg'] > 10), 0.7, 0.05)

    found = causes_of(tmp_path, rate, runs=3000).found
    assert found
    distance, heading = (part_about(found[0], name) for name in ('distance_m', 'heading_deg'))
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
    assert part_about(causes.found[2], 'time_of_day_h').high == pytest.approx(7.5, abs=0.2)
    added = [cause.added for cause in causes.found]
    assert added == sorted(added, reverse=True)
    assert causes.explained == pytest.approx(sum(added))
    assert causes.rest.rate == pytest.approx(0.03, abs=0.01)


def test_given_noise_when_looked_for_then_hardly_ever_a_cause_is_named(tmp_path):
    named = [
        seed for seed in range(12)
        if causes_of(
            tmp_path, lambda t: np.full(len(t), 0.2), runs=200, seed=seed, cross_track_m=0.0,
        ).found
    ]
    assert len(named) <= 1, f'named causes of nothing with seeds {named}'


@pytest.mark.parametrize(('rate', 'features'), [
    (lambda t: 0.05 + 0.05 * t['cross_track_m'].abs(), {'cross_track_m'}),
    (lambda t: np.where(t['clouds'].isin(['broken', 'overcast', 'stratus']), 0.35, 0.1),
     {'clouds', 'rain_percent'}),
    (lambda t: 0.05 + 0.1 * (12 - t['time_of_day_h']).clip(lower=0), {'time_of_day_h'}),
], ids=['offset', 'clouds', 'hour'])
def test_a_condition_without_effect_is_hardly_ever_in_a_first_cause(tmp_path, rate, features):
    firsts = [found[0] for seed in range(10)
              if (found := causes_of(tmp_path, rate, runs=200, seed=seed).found)]
    assert len(firsts) >= 6
    odd = [cause.region.words() for cause in firsts
           if {feature.source for feature in cause.region.features} - features]
    assert len(odd) <= 1, odd


def test_a_feature_that_matters_given_the_other_is_told_from_one_that_does_not(tmp_path):
    """Failures rise with the hour alone: the hour matters given the heading, not conversely."""
    table = planted_table(400, 2, lambda t: np.where(t['time_of_day_h'] < 9, 0.6, 0.1))
    scan = Scan(planted_runs(table, tmp_path).frame)
    p = {name: scan.p_given(name, np.random.default_rng(0))
         for name in ('time_of_day_h', 'heading_deg')}
    assert p['heading_deg'] == 1 / 200, 'more than the heading matters'
    assert p['time_of_day_h'] > 0.05


def test_the_p_value_given_a_feature_is_uniform_where_only_that_one_matters(tmp_path):
    values = []
    for seed in range(20):
        table = planted_table(80, seed, lambda t: np.where(t['rain_percent'] > 0, 0.7, 0.2))
        scan = Scan(planted_runs(table, tmp_path).frame)
        values.append(scan.p_given('rain_percent', np.random.default_rng(seed)))
    assert np.mean(np.array(values) <= 0.1) <= 0.25
    assert 0.3 <= np.mean(values) <= 0.7


def test_the_rim_of_a_cause_is_no_further_cause(tmp_path):
    """Failures fall off gently around the crossing: one cause, not another of the same runs."""
    def rate(table):
        return np.clip(1.1 - (table['distance_m'] - 1300).abs() / 250, 0.01, 0.98)

    causes = causes_of(tmp_path, rate, runs=3000)
    frame = planted_runs(planted_table(3000, 1, rate), tmp_path).frame
    masks = [cause.region.mask(frame) for cause in causes.found]
    assert masks
    for one, other in itertools.combinations(masks, 2):
        assert (one & other).sum() <= 0.5 * (one | other).sum()
    beyond = ~np.any(masks, axis=0)
    assert causes.rest.runs == beyond.sum(), 'the rim is outside all causes'
    failed = frame['failed'].to_numpy()
    assert causes.explained == pytest.approx(1 - failed[beyond].sum() / failed.sum())


@pytest.mark.parametrize('rate', [
    lambda t: np.clip((t['cross_track_m'].abs() - 3) / 5, 0.01, 0.98),
    lambda t: 0.02 + 0.95 * np.exp(
        -((t['distance_m'] - 1300) / 250)**2 - ((t['heading_deg'] - 5) / 10)**2),
], ids=['ring', 'blob'])
def test_what_lies_around_a_cause_in_its_own_features_is_no_further_cause(tmp_path, rate):
    first, *others = causes_of(tmp_path, rate, runs=3000).found
    named = {feature.name for feature in first.region.features}
    assert [
        one.region.words() for one in others
        if {feature.name for feature in one.region.features} <= named
    ] == []


@pytest.mark.parametrize(('runs', 'failing', 'words'), [
    (12, 2, '12 runs, 2 failures: too few to find causes'),
    (300, 300, '300 runs, 300 failures: all runs fail, so causes cannot be distinguished'),
    (300, 0, '300 runs, no failure: no causes'),
    (100, 98, '100 runs, 98 failures: too few other runs to distinguish causes'),
    (1, 1, '1 run, 1 failure: all runs fail, so causes cannot be distinguished'),
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


def test_t9_given_any_part_of_a_real_table_when_looked_for_then_the_search_ends():
    table = read_table(SHIPPED)
    # With the numbers 2, 9, 10, 13 and 19 a condition was added and sharpened away for ever.
    for seed in (2, 9, 13):
        causes = find_causes(runs_of(table.sample(400, random_state=seed), SHIPPED))
        assert causes.found
        assert all(1 <= len(cause.region.parts) <= 2 for cause in causes.found)


def test_t16_given_runs_of_a_search_when_looked_for_then_figures_are_of_what_was_scanned(tmp_path):
    """Weights that would turn the rates round: none of the figures of a cause may use them."""
    table = planted_table(1000, 3, lambda t: np.where(t['distance_m'] < 500, 0.6, 0.05))
    failed = table['outcome'] == 'FAIL'
    near = table['distance_m'] < 500
    weight = np.where(near & failed, 0.001, 1.0)
    causes = find_causes(planted_runs(table.assign(weight=weight, sampler='ce'), tmp_path))
    (cause,) = causes.found
    assert causes.searched
    assert cause.inside.rate == pytest.approx(0.6, abs=0.08)
    assert cause.outside.rate == pytest.approx(0.05, abs=0.03)
    assert cause.inside.failures / failed.sum() == cause.share
    assert np.isnan(cause.inside.low), 'a sampler that learns leaves no interval'
    assert 'of the runs made' in cause.inside.words()


def test_t16_given_two_causes_when_looked_for_then_what_goes_with_each_is_free_of_order(tmp_path):
    def rate(table):
        wet, crossing = table['rain_percent'] > 0, table['distance_m'].between(1200, 1450)
        return np.where(wet, 0.95, np.where(crossing, 0.9, 0.2))

    table = planted_table(3000, 4, rate)
    failed = (table['outcome'] == 'FAIL').to_numpy()
    found = find_causes(planted_runs(table, tmp_path)).found
    assert len(found) == 2
    frame = planted_runs(table, tmp_path).frame
    for cause in found:
        inside = cause.region.mask(frame)
        assert cause.share == failed[inside].sum() / failed.sum()
        alone = 1 - failed[~inside].mean() / failed.mean()
        value, low, high = cause.associated
        assert value == pytest.approx(alone)
        assert low < value < high
    # In the order of finding the second adds less than it holds.
    assert found[1].added < found[1].share - 0.03
    assert sum(cause.added for cause in found) <= 1


def test_t16_given_a_scene_that_was_run_again_and_again_then_it_counts_once(tmp_path):
    table = planted_table(60, 2, lambda t: np.full(len(t), 0.3))
    again = pd.concat([table] * 8, ignore_index=True).assign(
        index=range(480), run_id=[f'r{number}' for number in range(480)], sampler='grid')
    causes = find_causes(planted_runs(again, tmp_path))
    assert (causes.found, causes.again) == ((), 420)


def test_t6_given_slanted_crossed_and_round_causes_when_looked_for_then_they_are_named(tmp_path):
    def diagonal(table):
        apart = table['cross_track_m'] / 16 - table['heading_deg'] / 60
        return np.where(apart.abs() < 0.1, 0.9, 0.05)

    def crossed(table):
        return np.where((table['distance_m'] > 1000) ^ (table['heading_deg'] > 0), 0.7, 0.05)

    def night(table):
        return np.where(
            (table['time_of_day_h'] > 21.5) | (table['time_of_day_h'] < 3), 0.7, 0.05)

    (one,) = causes_of(tmp_path, diagonal, runs=600).found
    (slant,) = one.region.parts
    assert isinstance(slant, Slant)
    assert {slant.feature, slant.other} == {'cross_track_m', 'heading_deg'}
    assert slant.factor == pytest.approx(-16 / 60, rel=0.1)
    one, *_ = causes_of(tmp_path, crossed, runs=600).found
    (either,) = one.region.parts
    assert isinstance(either, Either)
    first, second = (part.words() for part in either.either)
    assert one.region.words() == f'{first} and not {second}, or {second} and not {first}'
    hours = np.random.default_rng(1).uniform(0, 24, 600)
    (one,) = causes_of(tmp_path, night, runs=600, time_of_day_h=hours).found
    (part,) = one.region.parts
    assert (part.low, part.high) == (pytest.approx(21.5, abs=0.6), pytest.approx(3, abs=0.6))
    assert one.region.words().startswith('after 21:')


@given(st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_t4_given_one_rate_then_the_mean_of_the_evidence_is_at_most_one(seed):
    """Exact, over all outcomes of a sampler that follows failures for as long as it can."""
    rng = np.random.default_rng(seed)
    rate, runs = rng.uniform(0.05, 0.95), 8
    left = rng.random() < 0.5
    mean = 0.0
    for outcomes in itertools.product((0, 1), repeat=runs):
        inside = failures = 0
        there = left
        for failed in outcomes:
            inside, failures = inside + there, failures + (there and failed)
            there = there if failed else not there
        count = sum(outcomes)
        chance = rate**count * (1 - rate) ** (runs - count)
        evidence = log_evidence(np.array([failures]), np.array([inside]), count, runs)[0]
        mean += chance * np.exp(evidence)
    assert mean <= 1 + 1e-9


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
    firsts, lasts, places = interval_cells(np.array(values), most)
    assert len(places) == len(values)
    assert all(firsts[place] <= value <= lasts[place]
               for place, value in zip(places, values, strict=True))
    ends = [end for cell in zip(firsts, lasts, strict=True) for end in cell]
    assert ends == sorted(ends), 'cells do not overlap'


@pytest.mark.parametrize(('feature', 'low', 'high', 'rounded'), [
    # Whole steps of 5 min; a gap of less than a step must not become the region.
    ('time_of_day_h', 23.02, 0.99, (23.0, 1.0)), ('time_of_day_h', 12.03, 12.01, (12.03, 12.01)),
    ('time_of_day_h', 12.05, 11.95, (12.05, 11.95)),
    ('time_of_day_h', 12.02, 11.9, (12.0, 11 + 11 / 12)),
    ('wind_direction_deg', 350.6, 9.2, (350.0, 10.0)),
    ('wind_direction_deg', 90.7, 90.4, (90.7, 90.4)),
])
def test_given_an_interval_over_midnight_when_rounded_then_it_is_not_turned_inside_out(
    feature, low, high, rounded,
):
    values = np.linspace(0.0, 359.0 if feature.startswith('wind') else 24.0, 2000)
    region = Region(parts=(Interval(feature=feature, low=low, high=high),))
    frame = pd.DataFrame({feature: values})
    found = round_limits(region, frame)
    (part,) = found.parts
    assert (part.low, part.high) == pytest.approx(rounded)
    assert (found.mask(frame) >= region.mask(frame)).all(), 'it holds at least what it held'


FACTS = {'runs': 40, 'specs': {'phi': 'always((abs(cte) <= 8))'}}
PARTS = (
    Slant(feature='cross_track_m', other='heading_deg', factor=-0.27, low=1.0, high=None),
    Kinds(feature='clouds', kinds=('overcast', 'stratus')),
    Either(either=(Interval(feature='time_of_day_h', low=None, high=9.0),
                   Interval(feature='distance_m', low=1000.0, high=None))),
)


def test_t5_given_a_cause_at_a_control_point_then_it_is_named_and_its_program_draws_it(tmp_path):
    point = 'wind_speed_mps@2.5'
    gust = np.random.default_rng(3).uniform(0, 20, 500)
    table = planted_table(
        500, 1, lambda t: np.where(t[point] > 12, 0.9, 0.05), **{point: gust}
    ).assign(program='gusty')
    runs = planted_runs(table, tmp_path)
    (cause, *_) = find_causes(runs).found
    assert [part.feature for part in cause.region.parts] == [point]
    assert re.fullmatch(r'wind above 1[12]\.\d m/s at 2\.5 s', cause.region.words())
    runs.facts.update(FACTS, program_text=(
        '# --- gusty.scenic ---\nmodel runway_world\nego = new Plane at (0, 400)\n'
        "param 'wind_speed@2.50' = Range(0, 20)\n"
    ))
    program = tmp_path / 'cause.scenic'
    program.write_text(cause_program(runs, cause))
    assert all(scene.points[point] >= 11 for scene in sample_scenarios(program, 5, 6))


@pytest.mark.parametrize('form', ['keys', 'short forms'])
def test_t5_given_a_cause_of_any_kind_then_its_program_draws_scenes_of_it_alone(tmp_path, form):
    table = planted_table(40, 1, lambda t: 0.5).assign(program='s_falsif.scenic')
    runs = planted_runs(table, tmp_path)
    runs.facts.update(FACTS)
    if form == 'short forms':  # the recorded program is of before keys had units
        text = find_program('s_falsif').read_text(encoding='utf-8')
        for short, key in SHORT_FORMS.items():
            text = text.replace(f'param {key} ', f'param {short} ')
        runs.facts['program_text'] = f'# --- s_falsif.scenic ---\n{text}'
    rate = FoundRate(40, 20, 0.5, 0.3, 0.7)
    cause = Cause(region=Region(parts=PARTS), rank=1, inside=rate, outside=rate, whole=rate,
                  share=0.5, added=0.5, associated=(0.0, 0.0, 0.0), p=0.01, p_is_bound=False)
    program = tmp_path / program_name(cause)
    program.write_text(cause_program(runs, cause))
    for scene in sample_scenarios(program, 5, 6):
        values = scene.to_human()
        assert values['cross_track_m'] - 0.27 * values['heading_deg'] >= 1 - 1e-6
        assert values['clouds'] in ('overcast', 'stratus')
        assert (values['time_of_day_h'] <= 9) != (values['distance_m'] >= 1000)
    command = confirmation_command(runs, cause, tmp_path)
    assert command.startswith(f'taxinet run {program} --runs 100 --seed 1000003 --perception')
    assert '--controller' not in command
    runs.facts['controller'] = 'mine.py:steer'
    assert '--controller mine.py:steer' in confirmation_command(runs, cause, tmp_path)


SETTINGS = {
    'seed': 4, 'runs': 40, 'controller': 'steering', 'world': 'salt_lake',
    'gains': {'cte_gain_rad_per_m': 0.25, 'heading_gain': 1.25},
    'overrides': {'clouds': 'clear'}, 'laid_over': {'shadows': False},
    'specs': {'other': 'always((speed <= 9))', 'phi': 'always((abs(cte) <= 8))'},
    'stop_on': 'decided', 'bounds': ['cte=-25:25', 'speed=0:9'], 'rates': ['cte=3'],
    'timing': 'latency perception=0.2',
}


def test_given_any_setting_then_the_command_of_a_cause_has_it(tmp_path):
    table = planted_table(40, 1, lambda t: 0.5).assign(
        program='s_falsif.scenic', perception='taxinet')
    runs = planted_runs(table, tmp_path)
    runs.facts.update(SETTINGS)
    command = confirmation_command(runs, cause_of(PARTS[1]))
    _, name, program, *words = shlex.split(command)
    assert (name, program) == ('run', 'cause-1.scenic')
    assert dict.fromkeys(zip(words[::2], words[1::2], strict=True)) == dict.fromkeys([
        ('--runs', '100'), ('--seed', '1000007'), ('--images', 'none'),
        ('--perception', 'taxinet'), ('--world', 'salt_lake'),
        ('--spec', 'phi=always((abs(cte) <= 8))'), ('--spec', 'other=always((speed <= 9))'),
        ('--stop-on', 'decided'), ('--bound', 'cte=-25:25'), ('--bound', 'speed=0:9'),
        ('--rate', 'cte=3'),
        ('--set', 'steering.cte_gain_rad_per_m=0.25'), ('--set', 'steering.heading_gain=1.25'),
        ('--latency', 'perception=0.2'),
    ])


def test_given_any_override_then_the_program_of_a_cause_has_it(tmp_path):
    mine = tmp_path / 'mine.yaml'
    mine.write_text((Path(catalogue.__file__).parent / 'shipped' / 'bikf_10.yaml').read_text())
    place = catalogue.typed_place(str(mine))
    table = planted_table(40, 1, lambda t: 0.5).assign(program='s_falsif.scenic')
    runs = planted_runs(table, tmp_path)
    runs.facts.update(FACTS, overrides={'place': place.reference, 'cross_track_m': '-3'},
                      laid_over={'shadows': False})
    cause = cause_of(PARTS[1])
    assert '--set' not in confirmation_command(runs, cause)
    program = tmp_path / 'analysis' / program_name(cause)
    program.parent.mkdir()
    write_scenes_program(runs, cause_program(runs, cause), program)
    mine.unlink()
    for scene in sample_scenarios(program, 5, 3):
        assert (scene.to_human()['place'], scene.cross_track_m, scene.shadows) == (
            place.reference, -3, False)
        assert scene.clouds in PARTS[1].kinds


@pytest.mark.parametrize(('facts', 'perception', 'why'), [
    ({}, 'taxinet', 'no campaign.db is beside the table'),
    (FACTS, '', 'was started before the campaign'),
    ({**FACTS, 'program_text': '# --- a.scenic ---\n\n# --- b.bin (sha256) ---\n12ab\n'},
     'taxinet', 'b.bin is too large'),
    ({**FACTS, 'overrides': {'place': 'mine@0123456789ab'}}, 'taxinet', 'mine@0123456789ab'),
])
def test_given_settings_that_are_not_known_then_there_is_no_command(
    tmp_path, facts, perception, why,
):
    table = planted_table(40, 1, lambda t: 0.5).assign(
        program='s_falsif.scenic', perception=perception)
    runs = planted_runs(table, tmp_path)
    runs.facts.clear()
    runs.facts.update(facts)
    assert why in why_no_program(runs)
    assert confirmation_command(runs, cause_of(PARTS[1])) is None


PAPERS = """model runway_world
param zulu_time = Range(6, 18) * 3600 + 8 * 3600
weather = Options({(Uniform(0, 1, 2, 3, 4, 5), 0): 2, (Uniform(3, 4, 5), Range(0.25, 1)): 1})
param cloud_type = weather[0]
param rain_percent = weather[1]
ego = new Plane at (Range(-8, 8), Range(0, 2000))
"""


def cause_of(*parts):
    rate = FoundRate(40, 20, 0.5, 0.3, 0.7)
    return Cause(region=Region(parts=parts), rank=1, inside=rate, outside=rate, whole=rate,
                 share=0.5, added=0.5, associated=(0.0, 0.0, 0.0), p=0.01, p_is_bound=False)


@pytest.mark.parametrize('overrides', [{}, {'place': 'bikf_10'}])
def test_given_a_program_in_the_papers_names_then_a_causes_program_speaks_them(tmp_path, overrides):
    runs = planted_runs(planted_table(40, 1, lambda t: 0.5).assign(program='mine'), tmp_path)
    runs.facts.update(
        FACTS, program_text=f'# --- mine.scenic ---\n{PAPERS}', overrides=overrides,
    )
    cause = cause_of(
        Kinds(feature='clouds', kinds=('overcast', 'stratus')),
        Interval(feature='rain_percent', low=30.0, high=None),
        Interval(feature='time_of_day_h', low=18.5 if overrides else 10.5, high=None),
    )
    program = tmp_path / program_name(cause)
    program.write_text(cause_program(runs, cause))
    with SceneSource(str(program), seed=5) as source:
        for index in range(6):
            values = source.scene(index).to_human()
            assert values['clouds'] in ('overcast', 'stratus')
            assert values['rain_percent'] >= 30
            assert values['time_of_day_h'] >= (18.5 if overrides else 10.5)


@pytest.mark.parametrize('overrides', [{}, {'place': 'nzqn_05'}])
def test_given_starts_in_percent_then_a_causes_program_requires_the_distance(tmp_path, overrides):
    runs = planted_runs(planted_table(40, 1, lambda t: 0.5).assign(program='mine'), tmp_path)
    text = 'model runway_world\nparam start_percent = Range(0, 100)\nego = new Plane at (2, 0)\n'
    runs.facts.update(FACTS, program_text=f'# --- mine.scenic ---\n{text}', overrides=overrides)
    program = tmp_path / 'cause.scenic'
    program.write_text(cause_program(
        runs, cause_of(Interval(feature='distance_m', low=700.0, high=900.0))))
    with SceneSource(str(program), seed=5) as source:
        assert all(700 <= source.scene(index).distance_m <= 900 for index in range(6))


IN_SETUP = """model runway_world
scenario Other():
    setup:
        ego = new Plane at (0, 9)
scenario Main():
    '''Drawn
in setup.'''
    setup:
        # of the paper
        param cloud_type = Uniform(0, 1, 2, 3, 4)
        param rain_percent = 0
        ego = new Plane at (Range(-8, 8), 400),
            facing Range(-5, 5) deg
AFTER = 3
"""


@pytest.mark.parametrize('text', [
    IN_SETUP,
    'model runway_world\nscenario Only():\n  param clouds = Uniform("overcast", "clear")\n'
    '  ego = new Plane at (Range(-8, 8), 400)',
])
def test_given_a_scenario_with_setup_then_a_causes_program_requires_it_there(tmp_path, text):
    runs = planted_runs(planted_table(40, 1, lambda t: 0.5).assign(program='mine'), tmp_path)
    runs.facts.update(FACTS, program_text=f'# --- mine.scenic ---\n{text}',
                      overrides={'slope_percent': '1'})
    cause = cause_of(Kinds(feature='clouds', kinds=('overcast', 'stratus')),
                     Interval(feature='cross_track_m', low=0.0, high=None))
    assert why_no_program(runs) == ''
    program = tmp_path / program_name(cause)
    program.write_text(cause_program(runs, cause))
    for scene in sample_scenarios(program, 5, 6):
        values = scene.to_human()
        assert values['clouds'] in ('overcast', 'stratus')
        assert values['cross_track_m'] >= 0
        assert values['slope_percent'] == 1


@pytest.mark.parametrize(('text', 'why'), [
    ('# --- mine.scenic ---\nscenario Main():\n    setup: ego = new Plane at (0, 4)\n',
     'in one line'),
    ('# --- mine.scenic ---\nfrom lib import Main\n# --- lib.scenic ---\nscenario Main():\n'
     '    setup:\n        ego = new Plane at (0, 4)\n', 'in lib.scenic'),
])
def test_given_a_scenario_to_which_nothing_can_be_added_then_it_is_said(tmp_path, text, why):
    runs = planted_runs(planted_table(40, 1, lambda t: 0.5).assign(program='mine'), tmp_path)
    runs.facts.update(FACTS, program_text=text)
    assert why_no_program(runs) == (
        f'the scenario of their program is {why}, to which requirements cannot be added')


def test_given_a_place_of_ones_own_then_a_causes_program_knows_it(tmp_path):
    mine = tmp_path / 'mine.yaml'
    mine.write_text((Path(catalogue.__file__).parent / 'shipped' / 'bikf_10.yaml').read_text())
    runs = planted_runs(planted_table(40, 1, lambda t: 0.5).assign(program='mine'), tmp_path)
    text = f'model runway_world\nparam place = Uniform("kmwh_04", "{mine}")\n'
    text = f'# --- mine.scenic ---\n{text}ego = new Plane at (0, 400)\n'
    runs.facts.update(FACTS, program_text=text)
    reference = catalogue.typed_place(str(mine)).reference
    assert reference != 'bikf_10'
    cause = cause_of(Kinds(feature='place', kinds=(reference,)))
    program = tmp_path / program_name(cause)
    program.write_text(cause_program(runs, cause))
    for scene in sample_scenarios(program, 5, 4):
        assert scene.to_human()['place'] == reference


def test_given_files_of_ones_own_that_go_then_a_causes_program_has_them_beside_it(tmp_path):
    runs = planted_runs(planted_table(40, 1, lambda t: 0.5).assign(program='mine'), tmp_path)
    shipped = (Path(catalogue.__file__).parent / 'shipped' / 'bikf_10.yaml').read_text()
    gone = tmp_path / 'gone' / 'mine.yaml'
    runs.facts.update(FACTS, program_text=(
        '# --- mine.scenic ---\nmodel runway_world\nfrom lib.where import ALONG\n'
        f'param place = "{gone}"\nego = new Plane at (0, ALONG)\n'
        '# --- lib/where.py ---\nALONG = 420\n'
        f'# --- {gone} ---\n{shipped.replace("name: bikf_10", "name: other")}'
    ))
    cause = cause_of(Interval(feature='distance_m', low=400.0, high=None))
    program = tmp_path / program_name(cause)
    write_scenes_program(runs, cause_program(runs, cause), program)
    (scene,) = sample_scenarios(program, 5, 1)
    assert scene.to_human()['place'].startswith('other@')
    assert scene.distance_m == 420


def test_given_parts_when_written_as_json_then_they_are_read_back():
    values = json.loads(json.dumps([asdict(part) for part in PARTS]))
    assert tuple(map(part_of, values)) == PARTS
