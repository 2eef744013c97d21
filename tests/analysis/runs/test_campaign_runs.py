"""What an analysis takes from a campaign's table: judged runs, weights, bounds; and refusals."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planted_runs import planted_runs, planted_table, record_facts

from taxinet_ros.analysis.campaign.findings import analyse
from taxinet_ros.analysis.campaign.report import TEXT, campaign_report
from taxinet_ros.analysis.report.text import sentences
from taxinet_ros.analysis.runs.campaign import (
    GroupRate,
    Weighting,
    difference,
    distinct_labels,
    group_rate,
    read_examined,
    read_runs,
)
from taxinet_ros.analysis.runs.features import BY_NAME
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import rate


def said_of(runs):
    return sentences(TEXT, 'rates', runs=runs)


def table(runs=60, **columns):
    return planted_table(runs, 1, lambda t: np.full(len(t), 0.4), **columns)


def test_given_runs_without_verdict_when_read_then_they_are_counted_and_in_no_rate(tmp_path):
    frame = table()
    frame.loc[:2, 'outcome'] = ['REJECTED', 'INFRA_ERROR', 'INFRA_ERROR']
    frame.loc[:2, ['rho', 'rho_phi', 'time_of_day_h']] = math.nan
    runs = planted_runs(frame, tmp_path)
    assert runs.others == {'INFRA_ERROR': 2, 'REJECTED': 1}
    assert len(runs.frame) == 57
    failures = int((frame['outcome'] == 'FAIL').sum())
    assert runs.rate()[:5] == (57, failures, *rate(failures, 57))
    assert runs.weighting is Weighting.DRAWN


def test_given_runs_that_were_stopped_when_read_then_their_bounds_are_taken(tmp_path):
    frame = table(4).assign(
        rho_phi=[math.nan, math.nan, 0.4, math.nan], outcome=['FAIL', 'PASS', 'PASS', 'FAIL'],
        stopped_early=True, left_runway=[None, False, False, None],
    )
    frame['rho_lower.phi'] = [-math.inf, 0.2, 0.4, -math.inf]
    frame['rho_upper.phi'] = [-3.5, 1.5, 0.4, 0.7]
    frame['rho_other'] = [1.0, 1.0, 1.0, -1.0]  # that is why the last one failed
    runs = planted_runs(frame, tmp_path)
    assert runs.frame['rho'].tolist() == [-3.5, 0.2, 0.4]
    assert runs.failed.tolist() == [True, False, False]
    assert (runs.stopped, runs.undecided) == (2, 1)
    assert runs.off_runway() is None


def test_given_another_formula_when_read_then_it_says_who_failed(tmp_path):
    frame = table()
    frame['rho_other'] = np.where(frame['index'] < 7, -1.0, 1.0)
    runs = planted_runs(frame, tmp_path, 'other')
    assert (runs.spec, runs.rate().failures) == ('other', 7)
    with pytest.raises(UsageError, match=r'spec none: not judged in .*; known: phi, other'):
        planted_runs(frame, tmp_path, 'none')


def test_given_a_search_when_rated_then_only_what_the_program_itself_drew_counts(tmp_path):
    frame = table(200)
    failed = (frame['outcome'] == 'FAIL').to_numpy()
    drawn = frame['index'].to_numpy() % 4 == 0
    searched = planted_runs(frame.assign(sampler='ce', weight=0.4, drawn=drawn), tmp_path)
    assert searched.weighting is Weighting.WEIGHTED
    assert searched.rate() == (200, failed.sum(), *rate(int((failed & drawn).sum()), 50), 50)


@pytest.mark.one_in(3)
@pytest.mark.parametrize('sampler', ['cmaes', 'halton', 'grid', 'ce'])
def test_given_a_search_without_draws_then_there_is_no_rate(sampler, tmp_path):
    """Also one of an older version, whose table does not say who drew what."""
    for weight in (math.nan, 1.0, 2.5):
        frame = table(200).assign(weight=weight, sampler=sampler)
        unknown = planted_runs(frame, tmp_path)
        assert unknown.weighting is Weighting.UNKNOWN
        assert unknown.rate().rate == (frame['outcome'] == 'FAIL').mean()
        assert math.isnan(unknown.rate().low)
        assert 'of the runs made' in unknown.rate().words()
        assert 'This search yields no failure rate' in said_of(unknown)[0]


def test_given_a_group_in_which_nothing_was_drawn_then_it_has_no_interval():
    failed = np.array([True] * 7 + [False])
    unknown = group_rate(failed, np.full(8, math.nan))
    assert unknown.rate == 7 / 8
    assert math.isnan(unknown.low)
    # Other runs of the campaign were drawn, so a share of these would pass for a rate.
    of_others = group_rate(failed, np.zeros(8))
    assert (of_others.runs, of_others.failures) == (8, 7)
    assert math.isnan(of_others.rate)
    assert math.isnan(of_others.low)
    assert of_others.words() == 'no rate, as the program itself drew none of them'


def test_given_undecided_runs_then_there_are_bounds_and_no_rate(tmp_path):
    """Runs stop when the headline fails; the other formula fails always along with it."""
    failed = np.arange(200) % 2 == 0
    frame = table(200).assign(
        outcome=np.where(failed, 'FAIL', 'PASS'), rho_phi=np.where(failed, math.nan, 1.0),
        rho_other=np.where(failed, math.nan, 1.0), stopped_early=failed,
        left_runway=pd.array([None if one else False for one in failed], dtype='boolean'),
    )
    frame['rho_lower.phi'] = np.where(failed, -3.0, 1.0)
    frame['rho_upper.phi'] = np.where(failed, -1.0, 1.0)
    frame['rho_lower.other'] = np.where(failed, -5.0, 1.0)
    frame['rho_upper.other'] = np.where(failed, 4.0, 1.0)
    runs = planted_runs(frame, tmp_path, 'other')
    assert (runs.undecided, runs.weighting) == (100, Weighting.UNDECIDED)
    assert not runs.weighting.rated
    assert runs.bounds == (rate(0, 200).low, rate(100, 200).high)
    assert math.isnan(runs.rate().low)
    assert runs.off_runway() is None, 'half of the runs were stopped before it was known'
    words = said_of(runs)[0]
    assert 'no failure rate of it' in words
    assert f'at most {100 * rate(100, 200).high:.1f} %' in words
    headline = planted_runs(frame, tmp_path)
    assert headline.weighting is Weighting.DRAWN
    assert headline.rate()[2:5] == rate(100, 200)


def test_given_an_interrupted_campaign_then_runs_after_a_gap_do_not_count(tmp_path):
    frame = table(60)
    frame = frame[~frame['index'].isin([50, 52])].reset_index(drop=True)
    runs = planted_runs(frame, tmp_path)
    record_facts(tmp_path, runs=60)
    runs = read_runs(runs.path)
    assert (runs.weighting, runs.anytime, runs.uncounted) == (Weighting.DRAWN, True, 8)
    failures = int((frame['outcome'] == 'FAIL')[:50].sum())
    assert runs.rate()[2:5] == rate(failures, 50, anytime=True)
    assert 'chosen by' not in said_of(runs)[0]
    assert any('8 of the runs are in no rate' in line for line in runs.warnings)
    frame[frame['index'] > 0].to_parquet(tmp_path / 'runs.parquet')
    first = read_runs(runs.path)
    assert (first.weighting, first.uncounted, first.bounds) == (Weighting.UNKNOWN, 57, (0.0, 1.0))
    assert math.isnan(first.rate().low)
    words = said_of(first)[0]
    assert 'follow one without a result' in words
    assert 'sampler' not in words


def test_given_a_table_alone_then_what_is_assumed_is_said(tmp_path):
    frame = table(60)
    path = tmp_path / 'mine.parquet'
    frame.to_parquet(path)
    runs = read_runs(path)
    assert not runs.anytime
    assert 'their number was fixed beforehand' in runs.unrecorded
    assert 'their program drew them' not in runs.unrecorded
    frame.drop(columns=['sampler']).to_parquet(path)
    assert 'their program drew them' in read_runs(path).unrecorded
    frame[frame['index'] != 20].to_parquet(path)
    gap = read_runs(path)
    assert (gap.anytime, gap.uncounted) == (True, 39)
    assert planted_runs(frame, tmp_path).unrecorded == ''


def test_given_another_number_of_runs_than_planned_then_the_intervals_hold_at_any(tmp_path):
    frame = table(60)
    failures = int((frame['outcome'] == 'FAIL').sum())
    for planned, anytime in ((60, False), (40, True), (80, True)):
        runs = planted_runs(frame, tmp_path)
        record_facts(tmp_path, first_runs=planned, runs=60)
        runs = read_runs(runs.path)
        assert runs.anytime is anytime
        assert runs.rate()[2:5] == rate(failures, 60, anytime=anytime)
        assert ('not fixed beforehand' in said_of(runs)[0]) is anytime


@given(st.integers(0, 40), st.integers(0, 40), st.integers(1, 40), st.integers(1, 40))
def test_given_two_groups_then_their_difference_has_an_honest_interval(k, m, n, o):
    one, other = (group_rate(np.arange(runs) < failures, np.ones(runs))
                  for failures, runs in ((min(k, n), n), (min(m, o), o)))
    gap = difference(one, other)
    assert gap.low <= gap.value <= gap.high
    assert gap.value == pytest.approx(one.rate - other.rate)
    back = difference(other, one)
    assert (back.low, back.high) == (pytest.approx(-gap.high), pytest.approx(-gap.low))


def test_given_newcombes_example_then_the_difference_is_near_his():
    one = group_rate(np.arange(70) < 56, np.ones(70))
    other = group_rate(np.arange(80) < 48, np.ones(80))
    gap = difference(one, other)
    # His method 10 has 0.0524 to 0.3339, from Wilson's intervals; the exact ones are wider.
    assert gap.low == pytest.approx(0.0524, abs=0.03)
    assert gap.high == pytest.approx(0.3339, abs=0.03)
    assert gap.clear


def test_given_what_is_no_campaign_when_read_then_one_line_says_so(tmp_path):
    with pytest.raises(UsageError, match=r'no such table; is .* a campaign\?'):
        read_runs(tmp_path / 'nowhere')
    (tmp_path / 'text.parquet').write_text('no table')
    with pytest.raises(UsageError, match='damaged'):
        read_runs(tmp_path / 'text.parquet')
    with pytest.raises(UsageError, match='no column time_of_day_h; of an older version'):
        planted_runs(table().drop(columns='time_of_day_h'), tmp_path)
    with pytest.raises(UsageError, match=r'no run was judged \(60 INFRA_ERROR\)'):
        planted_runs(table().assign(outcome='INFRA_ERROR', rho_phi=math.nan), tmp_path)
    with pytest.raises(UsageError, match='was judged, but has no distance_m'):
        planted_runs(table(distance_m=math.nan), tmp_path)


def test_given_campaigns_of_one_network_then_their_labels_differ(tmp_path):
    runs = planted_runs(table(), tmp_path)
    other = planted_runs(table(perception='weights/other.safetensors'), tmp_path)
    assert [one.label for one in distinct_labels([runs, other])] == ['network', 'other']
    assert len({one.label for one in distinct_labels([runs, runs, other])}) == 3


@pytest.mark.parametrize(('feature', 'low', 'high', 'words'), [
    ('time_of_day_h', 13 + 1 / 3, 15.75, 'between 13:20 and 15:45'),
    ('time_of_day_h', None, 7.5, 'before 07:30'),
    ('time_of_day_h', 16.0, None, 'after 16:00'),
    ('distance_m', 1150.0, 1600.0, 'start 1,150 to 1,600 m along the track'),
    ('rain_percent', 25.0, None, 'rain of 25 % or more'),
    ('rain_percent', None, 0.0, 'no rain'),
    ('heading_deg', None, -12.0, 'start heading below −12° (nose left positive)'),
    ('abs_cross_track_m', 5.5, None, 'start 5.5 m or more beside the centreline, to either side'),
])
def test_given_an_interval_then_it_is_said_in_peoples_units(feature, low, high, words):
    assert BY_NAME[feature].interval_words(low, high) == words


@given(st.sampled_from(sorted(BY_NAME)), st.floats(-2000, 2000), st.floats(0, 500))
def test_given_limits_when_rounded_then_they_still_hold_the_interval(name, low, width):
    feature = BY_NAME[name]
    floor, ceiling = feature.rounded(low, low + width)
    assert floor <= low + 1e-6
    assert ceiling >= low + width - 1e-6
    assert ceiling - floor <= width + 2 * feature.step + 1e-6


def test_given_no_run_then_its_rate_is_said_to_be_of_none():
    assert GroupRate(0, 0, math.nan, 0.0, 1.0, 0.0).words() == 'no run'


def test_given_runs_that_no_sampler_chose_then_they_are_as_drawn(tmp_path):
    frame = table().assign(weight=math.nan, sampler='')
    runs = planted_runs(frame, tmp_path)
    assert runs.weighting is Weighting.DRAWN
    failures = int((frame['outcome'] == 'FAIL').sum())
    assert runs.rate()[:5] == (60, failures, *rate(failures, 60))


def test_people2_given_a_campaign_with_warnings_when_read_then_summary_and_json_say_them(tmp_path):
    facts = {'warnings': ['gentle: no run can violate it']}
    runs = dataclasses.replace(planted_runs(table(20), tmp_path), facts=facts)
    assert runs.warnings == ('gentle: no run can violate it',)
    assert 'Warning: gentle: no run can violate it.' in said_of(runs)


def test_ros10_given_runs_that_passed_blind_when_read_then_summary_and_json_count_them(tmp_path):
    frame = table(20)
    frame['steps'] = 301
    frame['unusable_estimates'] = 15
    passed = frame.index[frame['outcome'] == 'PASS']
    failed = frame.index[frame['outcome'] == 'FAIL']
    frame.loc[[*passed[:2], failed[0]], 'unusable_estimates'] = 250
    runs = planted_runs(frame, tmp_path)
    assert runs.blind == 2
    assert said_of(runs)[-1] == (
        'Warning: 2 runs passed with more than 5 % of their frames without a usable estimate.'
    )
    assert planted_runs(frame.drop(columns=['steps']), tmp_path).blind == 0


def test_given_no_violation_of_the_headline_then_what_most_runs_violate_is_looked_into(tmp_path):
    frame = table(20).assign(rho_phi=1.0, rho=1.0, outcome='PASS')
    frame['rho_near'] = np.where(frame['index'] < 3, -1.0, 1.0)
    frame['rho_clear'] = np.where(frame['index'] < 5, -2.0, 1.0)
    frame.loc[:4, 'outcome'] = 'FAIL'
    path = tmp_path / 'c.parquet'
    frame.to_parquet(path)
    found = read_examined(path)
    assert (found.spec, found.rate().failures) == ('clear', 5)
    assert dict(found.examined.violated) == {'phi': 0, 'near': 3, 'clear': 5}
    first, *_, last = campaign_report(analyse(found)).summary[:-1]
    assert first == 'No run violates phi; looked into: clear, violated by 5 of 20 runs.'
    assert last == (
        f'Runs also violate near (3 of 20); look into that by: taxinet analyze {path} --spec near.')
    assert read_runs(path).spec == 'phi'
    assert read_examined(path, 'near').rate().failures == 3
    with pytest.raises(UsageError, match=r'spec none: not judged in .*; known: phi, near, clear'):
        read_examined(path, 'none')


def test_given_a_requirement_added_later_then_it_is_looked_into_if_asked_for(tmp_path):
    frame = table(20).assign(rho_phi=1.0, rho=1.0, outcome='PASS')
    frame['rho_added'] = -1.0
    record_facts(tmp_path, specs={'phi': 'always(cte < 2)'})
    path = tmp_path / 'runs.parquet'
    frame.to_parquet(path)
    found = read_examined(path)
    assert (found.spec, found.examined.also('')) == ('phi', '')
    assert read_examined(path, 'added').rate().failures == 20
