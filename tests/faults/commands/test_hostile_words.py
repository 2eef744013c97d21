"""Names and words that would like to be paths, formulas, markup or commands to a terminal."""

from __future__ import annotations

import csv
import dataclasses
import shutil
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from campaign_records import write_campaign
from five_outcomes import five_outcomes
from graph_runs import request, run, steps_in
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.bag.layout import run_folder
from taxinet_ros.cli.main import main
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PERCEPTION
from taxinet_ros.nodes.lockstep.perception import PerceptionNode
from taxinet_ros.scenes.programs import shipped_folder
from taxinet_ros.trials.record.book import run_name
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.table import read_table

HOSTILE = [
    '=HYPERLINK("http://x")', '+1', '-1', '@x', '<script>alert(1)</script>', '"><img src=x>',
    '\x1b[2J\x1b]0;x\x07', 'a\nb', '../../x', "'; DROP TABLE runs", '\u202egnp.exe', '\0',
]
FILE_NAMES = [word for word in HOSTILE if word.isprintable()]


@pytest.mark.ros
@pytest.mark.parametrize('name', ['../elsewhere', '/tmp/elsewhere', '..', '', '.x', '-rf', 'a/b'])
def test_given_a_run_whose_name_is_a_path_then_nothing_is_written_and_the_next_is_sound(
    name, tmp_path
):
    out = tmp_path / 'in' / 'bags'
    out.mkdir(parents=True)
    with composed_graph(GraphOptions(perception='truth', out=out, images='none')) as graph:
        refused, after = run(graph, request(name, 0.5), request('after', 0.5))
    assert refused.outcome is Outcome.REJECTED
    assert 'use letters, digits, _, - and . only' in refused.detail
    assert after.outcome.judged
    assert steps_in(out / 'after') == list(range(6))
    assert [path.name for path in out.iterdir()] == ['after']
    assert [path.name for path in tmp_path.iterdir()] == ['in']
    assert [path.name for path in out.parent.iterdir()] == ['bags']


@given(st.text(max_size=30))
def test_given_any_name_of_a_run_then_its_folder_is_within_the_campaigns_or_it_is_refused(name):
    out = Path('/campaigns/c')
    try:
        folder = run_folder(out, name)
    except UsageError:
        return
    assert folder.parent == out
    assert folder.resolve() == folder


@pytest.mark.parametrize('name', HOSTILE)
def test_given_any_name_of_a_program_then_its_runs_have_a_name_that_is_taken(name, tmp_path):
    options, _ = five_outcomes(tmp_path / 'c')
    asked = dataclasses.replace(options, program=f'{name}.scenic')
    assert run_folder(tmp_path, run_name(asked, 3)).parent == tmp_path


@pytest.mark.ros
def test_given_a_node_that_sends_codes_for_terminals_then_they_are_not_passed_on(
    tmp_path, monkeypatch
):
    def fail(self, message) -> None:
        raise ValueError('\x1b[2J\x1b]0;owned\x07 <b>')

    monkeypatch.setattr(PerceptionNode, '_know', fail)
    with composed_graph(GraphOptions(perception='truth', out=tmp_path, images='none')) as graph:
        (result,) = run(graph, request(duration=1.0))
    assert (result.outcome, result.who) == (Outcome.INFRA_ERROR, PERCEPTION)
    assert result.detail == r'ValueError: \x1b[2J\x1b]0;owned\x07 <b>'


@pytest.fixture(scope='module')
def hostile(tmp_path_factory) -> Path:
    """A campaign in which every word that comes from outside is hostile."""
    folder = tmp_path_factory.mktemp('hostile') / 'c'
    _, rows = five_outcomes(folder)
    spoilt = [
        dataclasses.replace(
            row, program=own, perception=own,
            detail=word if not row.outcome.judged else '',
            kind=word if row.outcome is Outcome.INFRA_ERROR else '',
            who=word if row.outcome is Outcome.INFRA_ERROR else '',
        )
        for row, word, own in zip(rows, HOSTILE * 4, FILE_NAMES * 9, strict=False)
    ]
    return write_campaign(folder, spoilt, read_campaign(folder).facts)


def test_given_hostile_words_in_a_table_then_no_cell_is_a_formula_and_parquet_has_them(hostile):
    with (hostile / 'runs.csv').open(newline='') as file:
        lines = list(csv.DictReader(file))
    words = {line[name] for line in lines for name in ('program', 'perception', 'kind', 'detail')}
    assert "'=HYPERLINK(\"http://x\")" in words
    assert not any(word.startswith(('=', '+', '-', '@')) for word in words)
    assert set(read_table(hostile)['program']) == set(FILE_NAMES)


@pytest.mark.nightly
def test_given_hostile_words_when_reported_then_pages_and_junit_hold_them_as_text(
    hostile, tmp_path, monkeypatch, capsys
):
    def taxinet(*words: object) -> None:
        monkeypatch.setattr(sys, 'argv', ['taxinet', *map(str, words)])
        with pytest.raises(SystemExit):
            main()

    taxinet('gate', hostile, '--min-satisfaction', '0.5', '--junit', tmp_path / 'j.xml')
    taxinet('analyze', hostile)
    out, err = capsys.readouterr()
    assert 'Traceback' not in err
    told = [one.get('value') for one in ElementTree.parse(tmp_path / 'j.xml').iter('property')]
    assert sum(value.startswith('INFRA_ERROR: ') for value in told) == 3
    page = (hostile / 'analysis' / 'report.html').read_text()
    assert '<script>alert' not in page
    assert '<img src=x' not in page
    assert '\x1b' not in page + out + err
    assert sorted(path.name for path in hostile.parent.iterdir()) == ['c']


@pytest.mark.ros
def test_given_a_program_of_a_hostile_name_then_it_runs_like_any_other(
    tmp_path, monkeypatch, capfd
):
    name = '=x $(touch owned) <img src=x>.scenic'
    monkeypatch.chdir(tmp_path)
    shutil.copy(shipped_folder() / 'nominal.scenic', name)
    monkeypatch.setattr(sys, 'argv', [
        'taxinet', 'run', name, '--perception', 'truth', '--images', 'none', '--set', 'duration=1',
        '--out', 'c',
    ])
    with pytest.raises(SystemExit, match=r'[01]'):
        main()
    assert 'Traceback' not in capfd.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == [name, 'c']
    (run_id,) = read_table(tmp_path / 'c')['run_id']
    assert run_id == '_x___touch_owned___img_src_x_-s0-00000'
    assert steps_in(tmp_path / 'c' / run_id) == list(range(11))
