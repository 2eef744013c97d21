"""``taxinet analyze`` from end to end: what it prints and writes, and what it refuses."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaign_records import write_campaign
from taxinet_process import taxinet_apart

from taxinet_ros.cli import main
from taxinet_ros.cli.progress import HEARTBEAT
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.sealed_json import read_sealed
from taxinet_ros.trials.record.row import RunRow


def table(runs: int, perception: str, early_fails: bool) -> pd.DataFrame:
    rng = np.random.default_rng(1)
    hours = rng.uniform(6, 18, runs)
    failed = (hours < 9) & early_fails
    return pd.DataFrame({
        'run_id': [f's-{number:05d}' for number in range(runs)], 'index': range(runs),
        'program': 's_falsif', 'seed': 1, 'sampler': 'random', 'weight': 1.0,
        'perception': perception, 'cross_track_m': rng.uniform(-8, 8, runs),
        'distance_m': rng.uniform(0, 2000, runs), 'heading_deg': rng.uniform(-30, 30, runs),
        'clouds': rng.choice(['clear', 'stratus'], runs), 'rain_percent': 0.0,
        'time_of_day_h': hours, 'outcome': np.where(failed, 'FAIL', 'PASS'),
        'rho': np.where(failed, -5.0, 1.0), 'rho_phi': np.where(failed, -5.0, 1.0),
        'left_runway': failed, 'bag': '',
    })


def rows_of(frame: pd.DataFrame) -> Iterator[RunRow]:
    for line in frame.drop(columns='rho').to_dict('records'):
        robustness = {'phi': RobustnessInterval.exactly(line.pop('rho_phi'))}
        yield RunRow(**{**line, 'outcome': Outcome(line['outcome']), 'robustness': robustness})


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a campaign ``c`` and a table ``better.parquet``; ``c`` is analysed."""
    folder = tmp_path_factory.mktemp('analyze')
    write_campaign(folder / 'c', rows_of(table(120, 'original', early_fails=True)), {'runs': 120})
    table(60, 'taxinet', early_fails=False).to_parquet(folder / 'better.parquet')
    done = taxinet_apart('analyze', 'c', '--baseline', 'better.parquet', cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ''
    (folder / 'stdout').write_text(done.stdout)
    return folder


def test_given_a_campaign_when_analysed_then_the_screen_names_the_cause(folder):
    text = (folder / 'stdout').read_text()
    lines = text.splitlines()
    assert lines[0].startswith('120 runs of s_falsif with original: ')
    assert lines[1].startswith('One cause contains all of the ')
    assert any(line.startswith('1  before 09:') for line in lines)
    assert 'original fails in ' in text
    assert lines[-1] == 'report: c/analysis/report.html'


def test_given_a_campaign_when_analysed_then_tables_pictures_and_page_are_written(folder):
    out = folder / 'c' / 'analysis'
    values = json.loads((out / 'analysis.json').read_text())
    assert sorted(values['files']) == sorted(path.name for path in out.iterdir())
    assert {'report.html', 'causes.csv', 'rho_by_hour.png', 'rho_by_distance.png',
            'runs.parquet'} <= set(values['files'])
    assert 'before 09:' in (out / 'report.html').read_text()
    (cause,) = values['causes']
    assert cause['region'][0]['feature'] == 'time_of_day_h'
    assert cause['explained'] == 1.0
    (baseline,) = values['baselines']
    assert (baseline['label'], baseline['failed']['failures']) == ('taxinet', 0)


@pytest.mark.nightly
def test_t2_given_runs_that_a_sampler_chose_when_analysed_then_there_is_no_rate_and_no_zero(
    tmp_path, capsys
):
    chosen = table(40, 'original', early_fails=True).assign(sampler='halton', drawn=False)
    chosen.to_parquet(tmp_path / 'c.parquet')
    words = ['analyze', str(tmp_path / 'c.parquet')]
    assert main._exit_code(lambda: main.app(words, standalone_mode=False)) == 3
    assert 'This search yields no failure rate' in capsys.readouterr().out


@pytest.mark.parametrize(('words', 'complaint'), [
    (['nowhere'], 'nowhere/runs.parquet: no such table; is nowhere a campaign?'),
    (['c', '--spec', 'other'], 'spec other: not judged in c; known: phi'),
    (['c', '--alpha', '7'], '--alpha 7: not within 0.002..0.5'),
    (['c', '--out', 'c'],
     'out c: contains files other than those of an analysis; choose a new folder'),
    (['c', '--baseline', 'stdout'], 'stdout/runs.parquet: no such table; is stdout a campaign?'),
])
def test_given_bad_input_then_one_line_says_so(folder, monkeypatch, capsys, words, complaint):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, 'argv', ['taxinet', 'analyze', *words])
    with pytest.raises(SystemExit) as ended:
        main.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == f'taxinet: error: {complaint}\n'


def test_given_json_when_asked_then_only_that_is_printed(folder, monkeypatch, capsys):
    from taxinet_ros.analysis.report import page as report_page

    monkeypatch.setattr(report_page, 'write_report', lambda *_, **__: [])
    monkeypatch.chdir(folder)
    monkeypatch.setenv(HEARTBEAT, '1e-9')
    monkeypatch.setattr(sys, 'argv', ['taxinet', 'analyze', 'better.parquet', '--json'])
    with pytest.raises(SystemExit) as ended:
        main.main()
    assert ended.value.code == 0
    out, err = capsys.readouterr()
    values = json.loads(out)
    # Without a terminal it still says what it is at, as often as it is asked to.
    said = [line for line in err.splitlines() if not line.startswith('taxinet: warning: ')]
    assert len(said) >= 2
    written = read_sealed(folder / 'better-analysis' / 'analysis.json').values
    assert values == written
    assert values['causes_why_not'] == '60 runs, no failure: no causes'
    assert values['runs_to_look_at'] == {}
