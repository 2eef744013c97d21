"""Two networks on the same scenes: known answers of shipped tables, and planted changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from planted_runs import planted_runs, planted_table

from taxinet_ros.analysis.campaign.compared import (
    changed_table,
    compared,
    compared_json,
    compared_report,
)
from taxinet_ros.analysis.causes.causes import find_causes
from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
from taxinet_ros.errors import UsageError

BAGS = Path(__file__).resolve().parents[3] / 'bags'
PLAIN = {
    'wind_speed_mps': 0.0, 'wind_direction_deg': 0.0, 'gust_mps': 0.0, 'gust_seed': 0.0,
    'runway_state': 'auto', 'slope_percent': 0.0, 'speed_mps': 5.0, 'crossing': True,
    'place': 'kmwh_04',
}


def of_shipped(one: str, other: str):
    return compared(*distinct_labels([
        read_runs(BAGS / f's_falsif_{name}_400.parquet') for name in (one, other)]))


@pytest.mark.nightly
@pytest.mark.filterwarnings('ignore')
def test_given_the_shipped_tables_then_the_pairs_are_those_that_a_join_by_hand_gives():
    tables = [
        pd.read_parquet(BAGS / f's_falsif_{name}_400.parquet').set_index('index')['outcome']
        for name in ('generic', 'specialised')
    ]
    first, second = (table.eq('PASS') for table in tables)
    found = of_shipped('generic', 'specialised')
    rates = found.satisfied
    assert (rates.pairs, found.unpaired, found.tested, found.clear) == (400, 0, True, False)
    assert (rates.first, rates.second) == (int(first.sum()), int(second.sum())) == (364, 372)
    assert (rates.only_second, rates.only_first) == (
        int((~first & second).sum()), int((first & ~second).sum())) == (13, 5)
    # 2 * P(at most 5 of 18 by a fair coin)
    assert rates.p_value == pytest.approx(2 * 12616 / 2**18)
    (cause,) = found.better.found
    assert 'along the track' in cause.region.words()
    assert cause.inside.failures == 13
    rows = changed_table(found).rows
    assert [row[0] for row in rows] == ['worse'] * 5 + ['better'] * 13
    told = compared_json(found)
    assert told['satisfied']['difference'] == pytest.approx(8 / 400)
    assert told['satisfied']['low'] < 0 < told['satisfied']['high']
    assert compared_report(found).summary[0].startswith('No difference between')
    mirrored = of_shipped('specialised', 'generic')
    assert mirrored.satisfied.only_first == rates.only_second
    assert mirrored.satisfied.difference.value == -rates.difference.value
    assert [each.region for each in mirrored.worse.found] == [cause.region]


def pair(folder, rate_before, rate_after, **columns):
    """Two campaigns of the same 200 scenes, each with its own failures."""
    runs = []
    for name, rate in (('before', rate_before), ('after', rate_after)):
        (folder / name).mkdir()
        table = planted_table(200, 5, rate, **{**PLAIN, **columns})
        runs.append(planted_runs(table.assign(perception=name), folder / name))
    return runs


def test_a_network_compared_with_itself_does_not_differ(tmp_path):
    def wet(table):
        return 0.1 + 0.8 * (table['rain_percent'] > 0)

    found = compared(*pair(tmp_path, wet, wet))
    assert (found.satisfied.only_first, found.satisfied.only_second) == (0, 0)
    assert (found.satisfied.p_value, found.clear) == (1.0, False)
    assert changed_table(found).rows == ()


def test_given_a_network_that_broke_in_rain_then_rain_is_named_and_only_as_worse(tmp_path):
    found = compared(*pair(
        tmp_path, lambda table: 0.0 * table['rain_percent'],
        lambda table: (table['rain_percent'] > 0).astype(float)))
    assert found.clear
    assert found.satisfied.only_second == 0
    assert found.better.found == ()
    (cause,) = found.worse.found
    assert 'rain' in cause.region.words()
    wet = int((found.scenes['rain_percent'] > 0).sum())
    assert found.satisfied.only_first == wet == cause.inside.failures
    first, *others = compared_report(found).summary
    assert first.startswith('after is worse than before.')
    assert any(line.startswith('Got worse: rain') for line in others)


def test_causes_of_better_and_worse_share_the_probability_of_naming_one_by_chance(
    tmp_path, monkeypatch,
):
    levels = []

    def looked_for(runs, alpha):
        levels.append(alpha)
        return find_causes(runs, alpha)

    monkeypatch.setattr('taxinet_ros.analysis.campaign.compared.find_causes', looked_for)

    def rate(table):
        return 0.0 * table['rain_percent']

    compared(*pair(tmp_path, rate, rate))
    assert levels == [0.025, 0.025]


def test_given_scenes_chosen_by_results_then_there_is_no_test_and_the_reason_is_said(tmp_path):
    found = compared(*pair(
        tmp_path, lambda table: 0.5 + 0 * table['rain_percent'],
        lambda table: 0.0 * table['rain_percent'], sampler='ce', weight=np.nan))
    assert (found.tested, found.clear) == (False, False)
    first = compared_report(found).summary[0]
    assert first.startswith('No test says whether after is better than before: the sampler ce')
    assert compared_json(found)['satisfied']['mcnemar_p'] is None


def test_given_no_common_scene_or_another_requirement_then_one_line_says_so(tmp_path):
    def rate(table):
        return 0.5 + 0 * table['rain_percent']

    one, other = pair(tmp_path, rate, rate)
    (tmp_path / 'far').mkdir()
    far = planted_runs(planted_table(50, 9, rate, **PLAIN), tmp_path / 'far')
    with pytest.raises(UsageError, match='no scene in common; run both with the same program'):
        compared(one, far)
    (tmp_path / 'quick').mkdir()
    quick = planted_runs(
        planted_table(200, 5, rate, **PLAIN, control_rate_hz=20.0), tmp_path / 'quick')
    with pytest.raises(UsageError, match='no scene in common, as control_rate_hz differs; run'):
        compared(one, quick)
    (tmp_path / 'psi').mkdir()
    table = planted_table(200, 5, rate, **PLAIN).rename(columns={'rho_phi': 'rho_psi'})
    with pytest.raises(UsageError, match=r'judged by phi, .* by psi'):
        compared(other, planted_runs(table, tmp_path / 'psi'))


def test_given_scenes_that_a_sampler_chose_too_then_only_the_drawn_ones_count_and_it_is_said(
    tmp_path,
):
    def always(table):
        return 0.0 * table['rain_percent']

    chosen = [number % 2 == 0 for number in range(200)]
    found = compared(*pair(tmp_path, always, always, sampler='active', drawn=chosen))
    assert (found.satisfied.pairs, found.uncounted, found.unpaired) == (100, 100, 0)
    assert any(line.startswith('In no figure: 100 more scenes that both were run in')
               for line in compared_report(found).summary)


def test_given_a_scene_that_was_drawn_often_then_each_of_its_runs_is_in_a_pair(tmp_path):
    folders = []
    for name, failing in (('before', 0), ('after', 150)):
        (folder := tmp_path / name).mkdir()
        table = planted_table(1, 5, lambda table: 0.0 * table['rain_percent'], **PLAIN)
        table = pd.concat([table] * 200, ignore_index=True)
        failed = np.arange(200) < failing
        folders.append(planted_runs(table.assign(
            index=range(200), run_id=[f'run-{number}' for number in range(200)], perception=name,
            outcome=np.where(failed, 'FAIL', 'PASS'), rho_phi=np.where(failed, -1.0, 1.0),
        ), folder))
    found = compared(*folders)
    assert (found.satisfied.pairs, found.satisfied.only_first, found.unpaired) == (200, 150, 0)
    assert found.clear
    assert compared_report(found).summary[0].startswith('after is worse than before.')


def test_given_runs_without_verdict_then_nothing_is_clear_that_they_could_undo(tmp_path):
    before, after = pair(
        tmp_path, lambda table: 0.0 * table['rain_percent'],
        lambda table: (table['run_id'].str[-3:].astype(int) < 9).astype(float))
    assert compared(before, after).clear
    (folder := tmp_path / 'crashing').mkdir()
    crashed = pd.read_parquet(after.path)
    open_ = crashed['index'].between(100, 104)
    crashed.loc[open_, ['outcome', 'rho', 'rho_phi']] = ['INFRA_ERROR', np.nan, np.nan]
    found = compared(before, planted_runs(crashed.assign(kind=np.where(open_, 'died', '')), folder))
    assert (found.unknown, found.satisfied.only_first, found.clear) == (5, 9, False)
    told = compared_report(found).summary
    assert 'the scenes of which a run has no verdict could undo it' in told[0]
    assert any('Runs of after without verdict: 5 INFRA_ERROR' in line for line in told)


def test_given_formulas_of_one_name_then_different_ones_are_refused(tmp_path):
    before, after = pair(tmp_path, *[lambda table: 0.0 * table['rain_percent']] * 2)
    before, after = (
        replace(some, facts={**some.facts, 'specs': {'phi': f'always(cte <= {limit})'}})
        for some, limit in ((before, 1), (after, 2))
    )
    with pytest.raises(UsageError, match=r'judged by phi=always\(cte <= 1\), .* by phi=always'):
        compared(before, after)
