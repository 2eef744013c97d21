"""``--cluster`` on the command line and in Python: the table of the local pool, and refusals."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pandas as pd
import pytest
from taxinet_process import taxinet

import taxinet_ros as tx
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import read_table

SEARCH = (
    'nominal', '--runs', '6', '--perception', 'truth', '--set', 'duration=1', '--seed', '4',
    '--sampler', 'halton', '--images', 'failures', '--spec', 'tight=always(abs(cte)<=0.3)',
    '--engine', 'loop', '--audit', '0',
)


def table(folder: Path) -> pd.DataFrame:
    found = read_table(folder).drop(columns=list(WALL_CLOCK_COLUMNS))
    assert len(found) == 6
    return found


def bags(folder: Path) -> dict[str, str]:
    return {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest()
        for file in folder.rglob('*.mcap')
    }


@pytest.fixture(scope='module')
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp('cluster') / 'here'
    done = taxinet('falsify', *SEARCH, '--workers', '2', '--out', out)
    assert done.returncode == 1, done.stderr
    return out


def test_given_a_cluster_then_table_and_bags_are_those_of_the_local_pool(here, tmp_path):
    out = tmp_path / 'there'
    done = taxinet('falsify', *SEARCH, '--cluster', 'local:2', '--out', out)
    assert (done.returncode, done.stderr) == (1, '')
    assert 'cluster local:2 -> ' in done.stdout.splitlines()[0]
    pd.testing.assert_frame_equal(table(out), table(here))
    assert len(bags(out)) == 6
    assert bags(out) == bags(here)
    assert {path.name for path in (out / 'logs').rglob('*')} == set()
    assert taxinet('doctor', out).returncode == 0


def test_given_python_then_it_has_the_cluster_too(here, tmp_path):
    found = tx.falsify(
        'nominal', runs=6, perception='truth', settings={'duration_s': 1}, seed=4,
        sampler='halton', specs='tight=always(abs(cte)<=0.3)', cluster='local:1', lag=3,
        out=tmp_path / 'there',
    )
    pd.testing.assert_frame_equal(
        table(found.folder).drop(columns='bag'), table(here).drop(columns='bag')
    )


@pytest.mark.parametrize(('words', 'named'), [
    (['--cluster', 'local:2', '--workers', '2'], 'workers 2: not with a cluster'),
    (['--cluster', 'nowhere.json'], 'cluster nowhere.json: No such file or directory'),
    (['--cluster', 'tcp://127.0.0.1'], 'expected tcp://HOST:PORT'),
    (['--cluster', 'local:1', '--perception', 'external'], 'a perception that you start yourself'),
    (['--lag', '0'], 'lag 0: needs to be within 1..10000'),
    (['--lag', '3', '--workers', '4'], 'workers 4: needs to be within 1..3'),
])
def test_given_what_does_not_go_together_then_it_is_refused_before_anything_is_begun(
    words, named, tmp_path
):
    engine = () if 'external' in words else ('--engine', 'loop')
    out = tmp_path / 'out'
    done = taxinet('falsify', 's_falsif', '--runs', '8', *engine, *words, '--out', out)
    assert (done.returncode, done.stdout) == (2, '')
    assert len(done.stderr.splitlines()) == 1
    assert named in done.stderr
    assert not out.exists()
