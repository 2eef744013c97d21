"""One campaign with all five outcomes: every output counts them, and a broken run is in no rate."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from xml.etree import ElementTree

import pandas as pd
import pytest
from five_outcomes import BROKEN, COUNTS, JUDGED, five_outcomes

from taxinet_ros.analysis.experiment.arms import paired_arms
from taxinet_ros.analysis.experiment.report import (
    experiment_json,
    experiment_report,
)
from taxinet_ros.analysis.report.page import write_report_page
from taxinet_ros.cli.main import main
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.trials.experiment import read_experiment
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.summary import Summary, campaign_summary, row_line

WORDS = '24 PASS, 12 FAIL, 2 REJECTED, 3 INFRA_ERROR (2 timeout, 1 died), 1 INTERRUPTED'
UNJUDGED = '3 INFRA_ERROR (2 timeout, 1 died), 1 INTERRUPTED, 2 REJECTED'
LINES = [
    'INFRA_ERROR timeout perception: silent for 10 s',
    'INFRA_ERROR died steering_controller: killed by SIGKILL',
    'INFRA_ERROR timeout simulator: silent for 60 s',
]


@pytest.fixture(scope='module')
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp('five') / 'c'
    options, rows = five_outcomes(folder)
    return folder, options, rows


@pytest.fixture
def taxinet(monkeypatch, capsys):
    """Call the command in this process; exit code and output."""

    def call(*words: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, 'argv', ['taxinet', *map(str, words)])
        with pytest.raises(SystemExit) as left:
            main()
        return int(left.value.code or 0), capsys.readouterr().out

    return call


def test_given_five_outcomes_when_printed_then_each_is_named_and_only_judged_runs_are_rated(
    campaign,
):
    _, options, rows = campaign
    printed = [row_line(row).plain for row in rows]
    assert [line for line in printed if 'INFRA_ERROR' in line] == [
        line for words in LINES for line in printed if words in line
    ]
    assert sum(' rho ' in line for line in printed) == JUDGED
    first, second, *_ = campaign_summary(Summary(rows), options).splitlines()
    assert first == WORDS
    # 24 of 36, in a campaign that was interrupted.
    assert second.startswith('satisfied 67% (95 % interval that holds wherever a campaign stops')


def test_given_five_outcomes_when_a_sampler_is_told_then_only_judged_runs_have_a_rho(campaign):
    _, _, rows = campaign
    told = {
        outcome: {
            row.robustness_for_sampler('phi_always') for row in rows if row.outcome is outcome
        } for outcome in Outcome
    }
    assert all(rho > 0 for rho in told[Outcome.PASS])
    assert all(rho < 0 for rho in told[Outcome.FAIL])
    for outcome in (Outcome.REJECTED, Outcome.INFRA_ERROR, Outcome.INTERRUPTED):
        assert told[outcome] == {None}


def test_given_five_outcomes_then_record_and_tables_have_kind_and_reason_and_no_rho(campaign):
    folder, _, rows = campaign
    kept = read_campaign(folder).rows
    assert [(row.outcome, row.kind, row.who, row.detail) for row in kept] == [
        (row.outcome, row.kind, row.who, row.detail) for row in rows
    ]
    csv = pd.read_csv(folder / 'runs.csv', keep_default_na=False, na_values={'rho': ['']})
    for table in (read_table(folder), csv):
        assert table['outcome'].value_counts().to_dict() == COUNTS
        broken = table[table['outcome'] == 'INFRA_ERROR']
        assert list(zip(broken['kind'], broken['who'], broken['detail'], strict=True)) == [
            (one.kind, one.who, one.detail) for one in BROKEN
        ]
        judged = table['outcome'].isin(['PASS', 'FAIL'])
        assert table.loc[judged, 'rho'].notna().all()
        assert table.loc[~judged, 'rho'].isna().all()
        assert (table.loc[judged, 'kind'] == '').all()


def test_given_five_outcomes_at_the_gate_then_junit_and_words_tell_them_apart(
    campaign, taxinet, tmp_path
):
    folder, _, rows = campaign
    asked = ('gate', folder, '--min-satisfaction', '0.4')
    code, out = taxinet(*asked, '--junit', tmp_path / 'j.xml')
    assert (code, out.split()[0]) == (4, 'INCONCLUSIVE:'), 'the bench broke; nothing is violated'
    assert taxinet(*asked, '--inconclusive', 'pass')[0] == 4
    assert taxinet(*asked[:3], '0.9')[0] == 1, 'that is shown without the broken runs'
    assert '24 PASS, 12 FAIL, 2 REJECTED, 3 INFRA_ERROR, 1 INTERRUPTED' in out
    assert '66.67 % of 36 runs are satisfied' in out
    assert '3 runs were broken by the bench and are in no share: 2 timeout, 1 died' in out
    values = json.loads(taxinet(*asked, '--json')[1])
    assert values['outcomes'] == {outcome.value: number for outcome, number in COUNTS.items()}
    assert values['judged'] == JUDGED
    (suite,) = ElementTree.parse(tmp_path / 'j.xml').getroot()
    told = [one.get('value') for one in suite.findall('properties/property')
            if one.get('name').startswith('run ')]
    assert len(told) == len(rows)
    for outcome, number in COUNTS.items():
        assert sum(value.startswith(outcome.value) for value in told) == number
    satisfied, broken = suite.findall('testcase')
    assert len(satisfied.findall('properties/property')) == COUNTS[Outcome.FAIL]
    assert [one.get('value') for one in broken.findall('properties/property')] == [
        f'{one.kind} {one.who} {one.detail}' for one in BROKEN]
    # A failure of its own tells that the bench broke.
    assert [suite.get(name) for name in ('tests', 'failures', 'skipped')] == ['2', '1', '0']


@pytest.mark.nightly
def test_given_five_outcomes_when_analysed_then_screen_page_and_numbers_count_them(
    campaign, taxinet
):
    folder, _, _ = campaign
    code, out = taxinet('analyze', folder)
    assert code == 0
    words = f'Without verdict, and in no rate: {UNJUDGED}.'
    assert words in out
    assert words in (folder / 'analysis' / 'report.html').read_text()
    assert out.startswith('36 runs of nominal with truth')
    values = json.loads((folder / 'analysis' / 'analysis.json').read_text())
    assert words in json.dumps(values)
    assert 'NaN' not in json.dumps(values)


EXPERIMENT = """
program: nominal
runs: 42
sampler: random
perception: truth
specs: [phi_always]
arms:
  before: {}
  after: {set: {shadows: off}}
"""


def test_given_five_outcomes_in_an_arm_then_its_report_counts_them_and_pairs_none(
    campaign, tmp_path: Path
):
    _, _, rows = campaign
    (tmp_path / 'mine.yaml').write_text(EXPERIMENT)
    experiment = read_experiment(tmp_path / 'mine.yaml')
    found = paired_arms(experiment, {'before': tuple(rows), 'after': tuple(rows)})
    assert len(found.comparisons[0].pairs) == JUDGED
    counted = UNJUDGED.replace('2 REJECTED', '').rstrip(', ')
    words = 'Runs of after without verdict, whose scenes are excluded: 2 REJECTED, ' + counted
    assert f'{words}.' in [*experiment_report(found).sentences]
    write_report_page(experiment_report(found), tmp_path / 'page.html')
    assert words in (tmp_path / 'page.html').read_text()
    arm = experiment_json(found)['arms']['after']
    assert arm == {outcome.value: number for outcome, number in COUNTS.items()}


def test_given_a_campaign_of_broken_runs_only_then_the_analysis_says_that_and_no_rate(
    tmp_path, monkeypatch, capsys
):
    folder = tmp_path / 'c'
    five_outcomes(folder)
    table = read_table(folder)
    broken = tmp_path / 'broken.parquet'
    table[table['outcome'] == 'INFRA_ERROR'].to_parquet(broken)
    monkeypatch.setattr(sys, 'argv', ['taxinet', 'analyze', str(broken)])
    with pytest.raises(SystemExit, match='2'):
        main()
    line, = capsys.readouterr().err.splitlines()
    assert 'no run was judged (3 INFRA_ERROR (2 timeout, 1 died))' in line
    assert line.endswith('nothing to analyse; the first: perception: silent for 10 s')
