"""The report on a campaign: its words, tables, pictures and files, for any number of runs."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from planted_runs import planted_runs, planted_table

from taxinet_ros.analysis.campaign.figures import rho_picture
from taxinet_ros.analysis.campaign.findings import analyse, compare
from taxinet_ros.analysis.campaign.folder import check_folder, write_analysis
from taxinet_ros.analysis.campaign.report import TEXT, campaign_report
from taxinet_ros.analysis.causes.causes import find_causes
from taxinet_ros.analysis.causes.predictors import rank_features
from taxinet_ros.analysis.experiment.pairs import paired_rates
from taxinet_ros.analysis.report import page as report_page
from taxinet_ros.analysis.report.pictures import DARK, LIGHT
from taxinet_ros.analysis.report.text import sentences
from taxinet_ros.analysis.runs.bins import bins, medians
from taxinet_ros.analysis.runs.campaign import difference, distinct_labels
from taxinet_ros.analysis.runs.features import PAPER_FEATURES, TIME_OF_DAY
from taxinet_ros.errors import UsageError
from taxinet_ros.files.sealed_json import read_sealed

ALIKE = {'clouds': 'clear', 'rain_percent': 0.0, 'cross_track_m': 0.0, 'distance_m': 1000.0,
         'heading_deg': 0.0}


def crossing(table):
    rain = table['rain_percent'] > 0
    return np.where(rain | table['distance_m'].between(1200, 1500), 0.95, 0.04)


def early(table):
    return np.where(table['time_of_day_h'] < 8, 0.9, 0.05)


@pytest.fixture(scope='module')
def runs(tmp_path_factory):
    return planted_runs(planted_table(400, 1, crossing), tmp_path_factory.mktemp('runs'))


@pytest.fixture(scope='module')
def findings(runs, tmp_path_factory):
    table = planted_table(400, 1, lambda t: np.full(len(t), 0.1), perception='better')
    return analyse(runs, [planted_runs(table, tmp_path_factory.mktemp('baseline'))])


def tables_of(report):
    return {table.name: table for section in report.sections for table in section.tables}


def said_of(runs, comparison):
    return ' '.join(sentences(TEXT, 'baseline', runs=runs, one=comparison))


def draw_all(report, theme):
    pictures = [picture for section in report.sections for picture in section.pictures]
    for picture in pictures:
        figure = Figure(figsize=picture.size_in, dpi=20, layout='constrained')
        picture.draw(figure, theme)
        FigureCanvasAgg(figure).draw()
        assert figure.axes, picture.name
        assert picture.title
        assert picture.caption.endswith('.')
    return [picture.name for picture in pictures]


def test_given_a_campaign_and_a_baseline_then_the_summary_says_what_matters(findings):
    report = campaign_report(findings)
    failures = findings.runs.rate().failures
    assert report.title == 'planted: 400 runs of network'
    assert report.summary[0].startswith('400 runs of planted with network: ')
    assert f'of the {failures} failures' in report.summary[1]
    assert report.summary[2].startswith('1. Rain of 25 % or more: ')
    assert 'along the track' in report.summary[3]
    last = report.summary[-1]
    assert last.startswith('network fails in ')
    assert 'better in ' in last
    assert 'Of 400 scenes that both were run in' in last


def test_given_the_same_scenes_then_changes_are_counted_in_pairs(findings):
    (one,) = findings.comparisons
    merged = findings.runs.frame.merge(one.baseline.frame, on='run_id')
    assert one.changed is not None
    assert one.changed.worse == int((merged['failed_x'] & ~merged['failed_y']).sum())
    assert one.changed.better == int((~merged['failed_x'] & merged['failed_y']).sum())
    assert one.changed.p < 0.001
    assert one.difference.low > 0
    assert len(one.in_causes) == len(findings.causes.found)


def compared(folder, here, there, count=60, **columns):
    """Comparison of campaigns of the same scenes, which fail in these runs."""
    def table(failing, **more):
        return planted_table(count, 1, lambda t: t['index'].isin(failing) * 1.0, **more)

    one, other = (
        planted_runs(frame, make(folder / name)) for name, frame in
        (('one', table(here)), ('other', table(there, perception='better', **columns)))
    )
    return one, other, lambda: compare(one, other, find_causes(one))


def make(folder):
    folder.mkdir()
    return folder


def test_given_the_same_scenes_then_the_difference_and_its_significance_are_paired(tmp_path):
    # 20 and 12 of 60 fail: of independent groups it would be chance, of pairs it is not.
    runs, baseline, comparison = compared(tmp_path, range(20), range(12))
    one = comparison()
    pairs = paired_rates(baseline.failed.tolist(), runs.failed.tolist())
    assert (one.paired, one.changed) == (True, (60, 8, 0, pytest.approx(2 * 0.5**8)))
    assert one.difference == pytest.approx(pairs.difference)
    assert not difference(runs.rate(), baseline.rate()).clear
    words = said_of(runs, one)
    assert 'in the same scenes' in words
    assert 'chance' not in words
    assert '(p = 0.008)' in words


def test_given_as_many_changes_to_either_side_then_they_may_be_chance(tmp_path):
    runs, _, comparison = compared(tmp_path, range(20), range(5, 24))
    assert ', which may be chance' in said_of(runs, comparison())


@pytest.mark.one_in(2)
@pytest.mark.parametrize(('key', 'value'), [
    ('wind_speed_mps', 5.0), ('place', 'bikf_10'), ('gust_seed', 3.0), ('traffic', '1_objects@0'),
    ('camera', 'nose'), ('duration_s', 60.0), ('slope_percent', 1.0), ('shadows', False),
])
def test_given_scenes_that_differ_in_any_key_then_they_are_not_the_same(tmp_path, key, value):
    _, _, comparison = compared(tmp_path, range(20), range(12), **{key: value})
    one = comparison()
    assert (one.paired, one.changed) == (False, None)


def test_given_an_open_number_of_runs_then_no_test_is_made_at_it(tmp_path):
    runs, baseline, _ = compared(tmp_path, range(20), range(12))
    one = compare(dataclasses.replace(runs, anytime=True), baseline, find_causes(runs))
    assert not one.paired
    assert math.isnan(one.changed.p)
    assert one.difference == difference(
        dataclasses.replace(runs, anytime=True).rate(), baseline.rate())


def test_given_a_table_of_before_a_key_then_it_has_the_scenes_of_its_default(tmp_path):
    frame = planted_table(60, 1, lambda t: t['index'].isin(range(20)) * 1.0)
    old = planted_runs(frame.drop(columns=['date', 'shadows']), make(tmp_path / 'old'))
    new = planted_runs(
        frame.assign(wind_speed_mps=0.0, place='kmwh_04', traffic='nobody', crossing=True),
        make(tmp_path / 'new'),
    )
    full = planted_runs(frame, make(tmp_path / 'full'))
    assert compare(full, new, find_causes(full)).changed.scenes == 60
    assert compare(old, new, find_causes(old)).changed is None, 'their date is not known'


def test_given_other_settings_then_the_comparison_names_them(tmp_path):
    runs, baseline, comparison = compared(tmp_path, range(20), range(12))
    same = {'specs': {'phi': 'always((cte <= 1))'}, 'gains': {}, 'world': 'kmwh'}
    runs.facts.update(same, perception_sha256='0a')
    baseline.facts.update(same, perception_sha256='0b')
    assert comparison().differing == (), 'another network has other weights'
    runs.facts.update(stop_on='never', bounds=[], timing='')
    baseline.facts.pop('world')
    assert comparison().differing == (), 'what older records lack is the default'
    baseline.facts.update(
        gains={'heading_gain': 1.0}, world='salt_lake', bounds=['cte=-25:25'],
        specs={'phi': 'always((cte <= 2))'}, timing='latency perception=0.2',
    )
    one = comparison()
    assert one.differing == ('gains', 'world', 'timing', 'assumed bounds', 'formula phi')
    assert 'Besides the network, these may differ: gains, world' in said_of(runs, one)
    baseline.facts.clear()
    assert 'no record' in said_of(runs, comparison())


def test_given_findings_then_every_table_has_its_columns_and_names_are_unique(findings):
    report = campaign_report(findings)
    tables = tables_of(report)
    assert {'rates', 'rates_by_feature', 'causes', 'feature_ranking', 'counterexamples'} == set(
        tables)
    for table in tables.values():
        assert table.rows, table.name
        assert {len(row) for row in table.rows} == {len(table.columns)}, table.name
    names = draw_all(report, LIGHT)
    assert len(names) == len(set(names)) == 4
    assert len({section.name for section in report.sections}) == len(report.sections)
    rates = tables['rates_by_feature']
    for feature in PAPER_FEATURES:
        assert sum(row[4] for row in rates.rows if row[0] == feature.title) == 400


def test_given_failures_then_all_kinds_come_first_among_the_counterexamples(findings):
    table = tables_of(campaign_report(findings))['counterexamples']
    ranks = [cause.rank for cause in findings.causes.found]
    assert len(ranks) == 2
    assert [row[9] for row in table.rows][:6] == [*ranks, None, *ranks, None]
    first, second = ([row[1] for row in table.rows if row[9] == rank] for rank in ranks)
    assert first == sorted(first)
    assert second == sorted(second)


def test_given_bags_then_only_failures_with_one_are_to_be_looked_at(tmp_path):
    table = planted_table(60, 1, early)
    table['bag'] = table['run_id']
    recorded = [run for run, outcome in zip(table['run_id'], table['outcome'], strict=True)
                if outcome == 'FAIL'][:3]
    for name in recorded:
        (tmp_path / name).mkdir()
        (tmp_path / name / f'{name}_0.mcap').write_bytes(b'')
    findings = analyse(planted_runs(table, tmp_path))
    assert sorted(campaign_report(findings).runs) == sorted(recorded)
    assert all(folder == tmp_path / name for name, folder in campaign_report(findings).runs.items())
    report = campaign_report(findings)
    rho = table.set_index('run_id')['rho'][list(report.runs)].tolist()
    assert rho == sorted(rho), 'the worst first'
    assert report.worst == next(iter(report.runs))
    assert list(report.rho.values()) == rho


@pytest.mark.parametrize(('count', 'columns', 'said'), [
    (3, {}, 'no failure: no causes'),
    (12, {**ALIKE, 'weight': math.nan, 'sampler': 'bo'}, 'This search yields no failure rate'),
])
def test_given_few_or_odd_runs_then_there_is_a_whole_report(tmp_path, count, columns, said):
    report = campaign_report(analyse(planted_runs(
        planted_table(count, 2, early, **columns), tmp_path)))
    assert len(draw_all(report, DARK)) == 3
    json.dumps([table.rows for table in tables_of(report).values()], allow_nan=False)
    assert said in ' '.join(report.summary)
    assert 'no failure' in report.summary[1] or 'too few' in report.summary[1]


def test_given_runs_of_a_sampler_then_the_summary_says_what_they_are_worth(tmp_path):
    drawn = np.arange(30) % 3 == 0
    runs = planted_runs(planted_table(30, 2, early, drawn=drawn, sampler='ce'), tmp_path)
    first = campaign_report(analyse(runs)).summary[0]
    assert 'Of the 10 runs among them that the program itself drew it is ' in first
    assert 'chosen by the sampler ce' in first


def test_given_an_analysis_when_written_then_files_are_there_and_its_own_are_replaced(
    findings, tmp_path, monkeypatch
):
    monkeypatch.setattr(report_page, 'write_report_page',
                        lambda report, path, **_: path.write_text('page'))
    report = campaign_report(findings)
    rates, *_ = report.sections
    bare = dataclasses.replace(
        report, sections=(rates,))
    out = tmp_path / 'out'
    values = write_analysis(findings, bare, out)
    assert read_sealed(out / 'analysis.json').values == values
    assert sorted(values['files']) == sorted(path.name for path in out.iterdir())
    assert {'rates.csv', 'rates_by_feature.png', 'report.html', 'runs.csv', 'runs.parquet',
            'analysis.json'} <= set(values['files'])
    assert (values['schema'], values['version']) == ('taxinet-analysis', 1)
    assert values['causes'][0]['region'] == [
        {'feature': 'rain_percent', 'low': 25.0, 'high': None}]
    kept = pd.read_parquet(out / 'runs.parquet')
    assert len(kept) == 400
    assert set(kept['cause']) >= {0, 1, 2}

    (out / 'notes.txt').write_text('mine')
    first = (out / 'rates_by_feature.png').read_bytes()
    check_folder(out)
    write_analysis(findings, dataclasses.replace(report, sections=()), out)
    assert not (out / 'rates.csv').exists(), 'what the new analysis lacks is gone'
    assert (out / 'notes.txt').read_text() == 'mine'
    write_analysis(findings, bare, out)
    assert (out / 'rates_by_feature.png').read_bytes() == first
    assert read_sealed(out / 'analysis.json').values == values


def test_given_a_foreign_folder_then_nothing_is_written_there(tmp_path):
    (tmp_path / 'notes.txt').write_text('mine')
    with pytest.raises(UsageError, match='contains files other than those of an analysis'):
        check_folder(tmp_path)
    (tmp_path / 'analysis.json').write_text('{"schema": "another"}')
    with pytest.raises(UsageError, match='contains files other'):
        check_folder(tmp_path)
    with pytest.raises(UsageError, match='not a folder'):
        check_folder(tmp_path / 'notes.txt')
    check_folder(tmp_path / 'new')


def test_given_few_runs_then_the_hours_of_a_map_end_where_the_runs_do(tmp_path):
    frame = planted_runs(planted_table(60, 1, early, time_of_day_h=np.linspace(6.2, 17.8, 60)),
                         tmp_path).frame
    for most in (1, 2):
        cut = bins(TIME_OF_DAY, frame, most)
        assert (cut[0].low, cut[-1].high) == (6.0, 18.0)


def test_given_a_feature_that_matters_then_it_ranks_first_and_others_do_not(tmp_path):
    frame = planted_runs(planted_table(800, 6, early), tmp_path).frame
    ranked = rank_features(frame)
    assert ranked[0].feature.name == 'time_of_day_h'
    assert ranked[0].p <= 0.01
    assert [one.p > 0.05 for one in ranked[1:]] == [True] * (len(ranked) - 1)
    assert 0 < ranked[0].explained < 1


def test_given_runs_then_bins_hold_each_once(runs):
    for feature in PAPER_FEATURES:
        counts = np.sum([one.mask for one in bins(feature, runs.frame)], axis=0)
        assert counts.tolist() == [1] * 400, feature.name
    middles, values, counts = medians(np.array([0.1, 0.2, 0.7, 1.0]),
                                      np.array([1.0, 3.0, 5.0, math.nan]), 0.5, least=1)
    assert (middles.tolist(), values.tolist(), counts.tolist()) == (
        [0.25, 0.75], [2.0, 5.0], [2.0, 1.0])


def test_given_three_networks_then_all_are_in_one_picture(runs, tmp_path):
    others = [planted_runs(planted_table(30, seed, early), tmp_path) for seed in (7, 8)]
    campaigns = distinct_labels([runs, *others])
    figure = Figure(figsize=(7, 3.6))
    rho_picture(campaigns, TIME_OF_DAY, 'rho').draw(figure, LIGHT)
    legend = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert [text.split(' (')[0] for text in legend] == [
        one.label.split(' (')[0] for one in campaigns]
