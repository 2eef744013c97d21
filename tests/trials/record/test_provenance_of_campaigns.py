"""Campaigns, tables and gates say on what runs were made, and where that was not one thing."""

from __future__ import annotations

from pathlib import Path

import falsify_samples as toy
import pytest

from taxinet_ros.analysis.campaign.report import TEXT
from taxinet_ros.analysis.report.text import sentences
from taxinet_ros.analysis.runs.campaign import CampaignRuns, read_runs
from taxinet_ros.cli.main import _exit_code, app
from taxinet_ros.core.provenance import differences, provenance
from taxinet_ros.core.scenario_fields import BY_KEY
from taxinet_ros.study.stages.run import StageRecord, stack_warning
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.record import facts as facts_module
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import STACKS, recorded_stacks, this_stack
from taxinet_ros.trials.record.table import read_table

ELSEWHERE = {**provenance(), 'processor': 'Another One', 'numpy': '0.1'}


def said_of(campaigns: list[CampaignRuns]) -> tuple[str, ...]:
    different = differences(*(stack for one in campaigns for stack in one.stacks))
    return sentences(TEXT, 'stacks', campaigns=campaigns, different=different)


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """From here on this process takes itself for one on another machine."""
    monkeypatch.setattr(facts_module, 'provenance', lambda: ELSEWHERE)


def test_provenance_is_in_record_rows_and_table(tmp_path):
    toy.finish(toy.options(tmp_path))
    record = {this_stack(): dict(provenance())}
    content = read_campaign(tmp_path)
    assert content.facts[STACKS] == recorded_stacks(content.facts) == record
    assert {row.stack for row in content.rows} == {this_stack()}
    for table in (read_table(tmp_path), read_table(tmp_path / 'runs.parquet')):
        assert set(table['stack']) == {this_stack()}
        assert table.attrs[STACKS] == record


def test_provenance_of_a_search_resumed_elsewhere_is_kept_for_each_sitting_and_warned_of(
    tmp_path, monkeypatch
):
    toy.finish(toy.options(tmp_path, runs=8))
    home = this_stack()
    same = toy.options(tmp_path, runs=12, resume=True)
    with toy.searching(same) as search:
        assert search.book.warning == ''
    monkeypatch.setattr(facts_module, 'provenance', lambda: ELSEWHERE)
    with toy.searching(toy.options(tmp_path, runs=12, resume=True)) as search:
        assert search.book.warning.startswith(f'{tmp_path}: begun on another machine or version: ')
        assert f'processor {provenance()["processor"]} | Another One' in search.book.warning
        assert f'numpy {provenance()["numpy"]} | 0.1' in search.book.warning
        for _ in toy.answers(search, 1):
            pass
    table = read_table(tmp_path)
    assert list(table['stack']) == [home] * 8 + [this_stack()] * 4
    assert list(table.attrs[STACKS]) == [home, this_stack()]


def test_provenance_of_tables_that_are_held_together_is_compared(tmp_path, elsewhere, monkeypatch):
    toy.finish(toy.options(tmp_path / 'there'))
    monkeypatch.undo()
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)
    toy.finish(toy.options(tmp_path / 'here'))
    here, there = read_runs(tmp_path / 'here'), read_runs(tmp_path / 'there')
    assert said_of([here]) == said_of([here, here]) == ()
    (sentence,) = said_of([here, there])
    assert f'processor {provenance()["processor"]} | Another One' in sentence
    table = read_table(tmp_path / 'here')
    table.attrs = {}
    table.to_parquet(tmp_path / 'old.parquet')
    old = read_runs(tmp_path / 'old.parquet')
    assert 'Machine and versions are unknown' in said_of([here, old])[0]


def test_provenance_of_several_sittings_is_a_note_of_the_gate(tmp_path, monkeypatch, capsys):
    toy.finish(toy.options(tmp_path, runs=8))
    words = ['gate', str(tmp_path), '--min-satisfaction', '0.01']
    _exit_code(lambda: app(words, standalone_mode=False))
    assert 'made on different machines' not in capsys.readouterr().out
    monkeypatch.setattr(facts_module, 'provenance', lambda: ELSEWHERE)
    toy.finish(toy.options(tmp_path, runs=12, resume=True))
    _exit_code(lambda: app(words, standalone_mode=False))
    out = capsys.readouterr().out
    assert 'note: the runs were made on different machines or versions: processor ' in out


def test_provenance_of_each_stage_of_a_study_is_recorded_and_compared():
    begun = StageRecord().started('i', 3, resumed=False)
    assert begun.stacks == (dict(provenance()),)
    assert stack_warning({'falsify': begun}) == ''
    other = StageRecord(stacks=({**provenance(), 'numpy': '0.1'},))
    assert f'numpy 0.1 | {provenance()["numpy"]}' in stack_warning({'falsify': other})


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    'path', sorted((Path(__file__).parents[3] / 'bags').glob('s_falsif_*.parquet')),
    ids=lambda path: path.stem,
)
def test_s11_every_shipped_table_has_every_documented_column(path):
    page = (Path(__file__).parents[3] / 'docs' / 'falsification.md').read_text()
    rows = page.partition('| columns | what |')[2].partition('\n\n')[0].splitlines()[2:]
    keys = '| the [keys of the scenario](reference/scenario.md) | the scene |'
    assert keys in rows
    documented = {*BY_KEY, *(
        name.strip('`') for row in rows if row != keys
        for name in row.split('|')[1].replace(',', ' ').split()
    )}
    patterns = {'u_*', 'sigma_*', 'he_error_*_deg', 'rho_<formula>', 'rho_lower.<formula>',
                'rho_upper.<formula>'}
    assert patterns < documented
    table = read_table(path)
    assert documented - patterns <= set(table.columns)
    assert {'rho_phi_eventually', 'he_error_mean_abs_deg'} <= set(table.columns)
    drawn = table[table['clouds'] != '']
    assert len(drawn) > 300
    assert drawn['crossing'].all(), 'it could not be taken away when these were run'
