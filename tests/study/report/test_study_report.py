"""Every figure of a study's report is that of its tables, and its words follow from figures."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from report_browser import browser, opened
from scipy.stats import binomtest
from study_examples import FAILING, PROBABILITIES, RUNS, made_up_study

from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import typed
from taxinet_ros.study.report.claim import Verdict
from taxinet_ros.study.report.paper import judge_claims
from taxinet_ros.study.report.report import (
    StudyFindings,
    gather_findings,
    study_report,
    study_values,
    write_study_report,
)
from taxinet_ros.study.report.results import read_results
from taxinet_ros.study.stages.config import StudyConfig
from taxinet_ros.study.stages.plan import campaign_of
from taxinet_ros.study.stages.run import read_options

__all__ = ['browser']


@pytest.fixture(scope='module')
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with its report."""
    out = tmp_path_factory.mktemp('reported')
    write_study_report(made_up_study(out), out)
    return out


@pytest.fixture(scope='module')
def found(study: Path) -> StudyFindings:
    """What is in that study's folder, read once more."""
    return gather_findings(typed(StudyConfig, read_options(study, 'case-study', '')), study)


def values(study: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((study / 'report' / 'case_study.json').read_text())
    return found


def judged(study: Path, network: str) -> pd.DataFrame:
    table = pd.read_parquet(study / campaign_of(network) / 'runs.parquet')
    return table[table['outcome'].isin(['PASS', 'FAIL'])].set_index('index')


def test_given_tables_then_each_network_s_rates_are_theirs_with_exact_intervals(study):
    frame = pd.read_parquet(study / 'report' / 'networks.parquet').set_index('network')
    assert list(frame.index) == list(FAILING)
    for name, line in frame.iterrows():
        runs = judged(study, str(name))
        assert (line['runs'], line['without_verdict']) == (len(runs), 1) == (RUNS - 1, 1)
        counts = {'satisfied': (runs['outcome'] == 'PASS').sum(), 'off_runway':
                  runs['left_runway'].sum()}
        for kind, count in counts.items():
            exact = binomtest(int(count), len(runs)).proportion_ci()
            assert line[f'{kind}_runs'] == count
            assert line[kind] == pytest.approx(count / len(runs))
            assert (line[f'{kind}_low'], line[f'{kind}_high']) == pytest.approx(tuple(exact))
        assert line['median_rho'] == pytest.approx(runs['rho'].median())
    assert frame['paper_satisfied'].tolist() == [0.552, 0.82, 0.83, 0.86]
    assert frame['paper_off_runway'].tolist() == [0.091, 0.039, 0.006, 0.005]


@pytest.mark.parametrize(('file', 'column', 'unit', 'width'), [
    ('rho_by_hour', 'time_of_day_h', 'h', 1), ('rho_by_distance', 'distance_m', 'm', 100),
])
def test_given_tables_then_bins_hold_every_run_once_and_its_figures(
    study, file, column, unit, width
):
    frame = pd.read_parquet(study / 'report' / f'{file}.parquet')
    for name in FAILING:
        runs = judged(study, name)
        bins = frame[frame['network'] == name]
        assert bins['runs'].sum() == len(runs)
        groups = runs.groupby(runs[column] // width * width)
        expected = groups['outcome'].apply(lambda column: (column == 'PASS').mean())
        full = bins[bins['runs'] > 0]
        assert full[f'from_{unit}'].tolist() == expected.index.tolist()
        assert full['satisfied'].to_numpy() == pytest.approx(expected.to_numpy())
        assert full['median_rho'].to_numpy() == pytest.approx(groups['rho'].median().to_numpy())


def test_given_pairs_then_differences_are_over_common_scenes_with_mcnemar_s_test(study):
    frame = pd.read_parquet(study / 'report' / 'pairs.parquet')
    line = frame[(frame['first'] == 'halton') & (frame['second'] == 'specialised')].iloc[0]
    passed = [judged(study, name)['outcome'] == 'PASS' for name in ('halton', 'specialised')]
    only = [int((one & ~other).sum()) for one, other in (passed, passed[::-1])]
    assert line['scenes'] == RUNS - 1
    assert [line['satisfied_only_first'], line['satisfied_only_second']] == only
    assert line['satisfied_difference'] == pytest.approx((only[1] - only[0]) / (RUNS - 1))
    assert line['satisfied_mcnemar_p'] == pytest.approx(binomtest(only[0], sum(only)).pvalue)
    assert line['satisfied_difference_low'] < line['satisfied_difference']


def test_given_what_was_learned_then_its_stretches_stand_beside_the_paper_s(study):
    frame = pd.read_parquet(study / 'report' / 'learned.parquet')
    planted = [
        PROBABILITIES[0], sum(PROBABILITIES[1:6]), *PROBABILITIES[6:8], sum(PROBABILITIES[8:])]
    for end in ('', '_least', '_greatest'):
        assert frame[f'ce{end}'].to_numpy() == pytest.approx(planted)
    spread = [frame[f'ce-verifai{end}'][3] for end in ('_least', '', '_greatest')]
    assert spread == pytest.approx([planted[3] - 0.04, planted[3] - 0.02, planted[3]])
    assert frame['program'].to_numpy() == pytest.approx([0.1, 0.5, 0.1, 0.1, 0.2])
    assert frame['weighted'].to_numpy() == pytest.approx(
        [share / 28 for share in (2, 10, 2, 10, 4)])
    assert (frame['weighted_low'] < frame['weighted']).all()
    assert frame['paper'].fillna(-1).tolist() == [0.05, -1, 0.16, 0.79, -1]
    runs = judged(study, 'generic')
    failed = runs[runs['outcome'] == 'FAIL']
    assert frame['failures'].sum() == len(failed)
    assert frame['failures'][3] == failed['distance_m'].between(1400, 1600).sum()


def test_given_planted_differences_then_the_words_follow_from_them(study):
    verdicts = {claim['name']: claim['verdict'] for claim in values(study)['claims']}
    assert verdicts['morning'] == 'agrees'
    assert verdicts['late_morning'] == 'differs'
    assert verdicts['original_crossing'] == 'agrees'
    assert verdicts['blame'] == 'unclear'  # 19 of 20
    assert verdicts['shadows'] == 'agrees'
    assert verdicts['generic'] == 'agrees'
    assert verdicts['specialised_crossing'] == 'agrees'
    assert verdicts['specialised_elsewhere'] == 'agrees'
    assert verdicts['learned'] == 'unclear'  # the searches are few
    assert not [name for name in verdicts if name.startswith('iterative')]


@pytest.mark.nightly
def test_given_the_opposite_then_it_is_not_as_in_the_paper_and_equals_are_not_clear(tmp_path):
    config = made_up_study(tmp_path)
    folders = [tmp_path / campaign_of(name) / 'runs.parquet' for name in ('original', 'generic')]
    tables = [path.read_bytes() for path in folders]
    for path, table in zip(folders, tables[::-1], strict=True):
        path.write_bytes(table)
    swapped = {claim.name: claim.verdict for claim in judge_claims(read_results(config, tmp_path))}
    assert swapped['generic'] is Verdict.DIFFERS
    assert swapped['generic_off'] is Verdict.DIFFERS
    folders[0].write_bytes(folders[1].read_bytes())
    equal = {claim.name: claim for claim in judge_claims(read_results(config, tmp_path))}
    assert equal['generic'].verdict is Verdict.UNCLEAR
    assert '+0.0 points' in equal['generic'].evidence


@pytest.mark.parametrize('key', ['distance_m', 'duration_s'])
def test_given_other_scenes_then_the_networks_are_not_compared(tmp_path, key):
    config = made_up_study(tmp_path)
    path = tmp_path / 'evaluate-halton' / 'runs.parquet'
    table = pd.read_parquet(path)
    table.loc[7, key] += 1
    table.to_parquet(path)
    with pytest.raises(UsageError, match=f'differ in {key}; evaluate both networks'):
        gather_findings(config, tmp_path)


def test_given_a_report_then_it_tells_what_is_done_and_what_it_cost(study):
    found = values(study)
    assert found['summary'][0] == '2 of 28 stages are done; the next is train-original.'
    assert found['summary'][-1].startswith('The stages that are done took 2 h on ')
    assert found['summary'][1].startswith('4 networks, judged on 899 runs of s_falsif, seed 0')
    stages = {stage['stage']: stage for stage in found['stages']}
    assert stages['evaluate-generic']['wall_s'] == 3725.0
    assert stages['evaluate-halton']['done'] is False
    assert stages['evaluate-halton']['command'].startswith('taxinet falsify s_falsif --sampler ')
    assert found['localized']['substitutions'][0]['passed'] == 19


def test_given_a_campaign_under_way_then_the_report_says_which_and_how_far(found):
    more = dataclasses.replace(found, config=dataclasses.replace(found.config, runs=RUNS + 1))
    done, under_way = (study_report(one).sections[0].sentences for one in (found, more))
    assert not any('Not all runs' in sentence for sentence in done)
    assert under_way[0] == 'Not all runs are done yet: ' + ', '.join(
        f'{name} {RUNS:,} of {RUNS + 1:,}' for name in FAILING
    ) + '.'


def test_given_a_study_when_read_again_then_every_figure_and_picture_is_the_same(study, found):
    assert study_values(found) == values(study)
    (picture,) = study_report(found).sections[0].pictures
    assert png_bytes(picture, LIGHT) == (study / 'report' / 'networks.png').read_bytes()


def test_given_the_page_when_opened_then_it_is_whole_and_quiet(browser, study):
    for colours in ('light', 'dark'):
        with opened(browser, study / 'report' / 'case_study.html', colours=colours) as page:
            headings = page.tab.locator('h2').all_inner_texts()
            assert 'What the paper says, and what we see' in headings
            assert 'Along the runway (Fig. 6)' in headings
            assert page.tab.locator('.picture img:visible').count() == 7
            cells = page.tab.locator('.table').first.locator('tbody tr').first.inner_text().split()
            assert cells[:2] == ['original', str(RUNS - 1)]
            wide = 'document.documentElement.scrollWidth - document.documentElement.clientWidth'
            assert page.tab.evaluate(wide) == 0


def test_given_a_study_without_any_campaign_then_there_is_nothing_to_report(tmp_path):
    config = made_up_study(tmp_path)
    for name in FAILING:
        (tmp_path / campaign_of(name) / 'runs.parquet').unlink()
    with pytest.raises(UsageError, match='no network was evaluated yet'):
        write_study_report(config, tmp_path)
