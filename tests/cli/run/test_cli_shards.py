"""The recipes of docs/scaling.md, executed as SLURM and Kubernetes would; and ``taxinet merge``."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
import pytest
import yaml
from taxinet_process import taxinet

from taxinet_ros.campaign.record.table import WALL_CLOCK_COLUMNS, read_table

pytestmark = [pytest.mark.nightly, pytest.mark.ros]
PAGE = (Path(__file__).parents[3] / 'docs' / 'scaling.md').read_text(encoding='utf-8')
SEARCH = (
    'nominal --runs 5 --perception truth --set duration=1 --seed 4 --sampler halton '
    '--sampler-option floor=0.4 --images none --spec tight=always(abs(cte)<=0.3)'
)


def blocks(language: str) -> list[str]:
    return re.findall(rf'```{language}\n(.*?)```', PAGE, re.DOTALL)


def started(script: str, folder: Path, **environment: str) -> subprocess.Popen[str]:
    """The script of a recipe, with a smaller search, as the scheduler starts it."""
    words = ' '.join(f"'{word}'" for word in SEARCH.split())
    small, count = re.subn(
        r'^( *)search=\(.*\)$', rf'\1search=({words})', script, flags=re.MULTILINE
    )
    assert count == 1
    path = f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}'
    return subprocess.Popen(
        ['bash', '-c', small], cwd=folder, env={**os.environ, 'PATH': path, **environment},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )


def ended_well(tasks: list[subprocess.Popen[str]]) -> list[str]:
    told = [task.communicate()[0] for task in tasks]
    assert [task.returncode for task in tasks] == [0] * len(tasks), told
    return told


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    out = tmp_path_factory.mktemp('shards') / 'whole'
    done = taxinet('falsify', *SEARCH.split(), '--out', str(out))
    assert done.returncode == 1, done.stderr
    return compared(out)


def compared(folder: Path) -> pd.DataFrame:
    table = read_table(folder).drop(columns=list(WALL_CLOCK_COLUMNS))
    assert len(table) == 5
    return table


def slurm(number: int, folder: Path) -> Mapping[str, str]:
    return {
        'SLURM_ARRAY_TASK_ID': str(number), 'SLURM_ARRAY_TASK_COUNT': '2',
        'SLURM_CPUS_PER_TASK': '2', 'SLURM_SUBMIT_DIR': str(folder),
    }


def test_given_the_slurm_recipe_then_its_tasks_make_the_shards_and_one_put_back_resumes(
    whole, tmp_path
):
    script, = (block for block in blocks('sh') if '#SBATCH' in block)
    ended_well([started(script, tmp_path, **slurm(number, tmp_path)) for number in (1, 2)])
    told, = ended_well([started(script, tmp_path, **slurm(2, tmp_path))])  # as after --requeue
    assert told.startswith('resuming nominal for failures: up to 5 runs, shard 2/2 (2 of the 5')
    merge = re.search(r'`taxinet (merge search/shard-\* --out search/merged)`', PAGE)
    assert merge
    shards = sorted((tmp_path / 'search').glob('shard-*'))
    done = taxinet('merge', *shards, '--out', tmp_path / 'search' / 'merged')
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout.startswith('2 shards merged: ')
    assert 'under the program itself: satisfied' in done.stdout
    pd.testing.assert_frame_equal(compared(tmp_path / 'search' / 'merged'), whole)
    assert taxinet('doctor', tmp_path / 'search' / 'merged').returncode == 0
    files = list((tmp_path / 'search' / 'merged').glob('*/*.mcap'))
    assert len(files) == 5
    assert all(path.stat().st_nlink == 2 for path in files)
    again = taxinet('merge', *shards, '--out', tmp_path / 'search' / 'merged')
    assert (again.returncode, again.stderr.count('\n')) == (2, 1)
    gate = taxinet('gate', shards[0], '--min-satisfaction', '0.5')
    assert 'note: this is shard 1/2 of a search, by itself; taxinet merge joins all' in gate.stdout


def test_given_the_kubernetes_recipe_then_its_pods_make_the_shards(whole, tmp_path):
    job = yaml.safe_load(blocks('yaml')[0])
    assert job['spec']['completionMode'] == 'Indexed'
    container, = job['spec']['template']['spec']['containers']
    told = {one['name']: one['value'] for one in container['env']}
    assert told['SHARDS'] == str(job['spec']['completions'])
    assert container['command'] == ['bash', '-c']
    script, = container['args']
    ended_well([
        started(script, tmp_path, SHARDS='2', RESULTS=str(tmp_path), JOB_COMPLETION_INDEX=index)
        for index in ('0', '1')
    ])
    out = tmp_path / 'merged'
    done = taxinet(
        'merge', tmp_path / 'search/shard-2', tmp_path / 'search/shard-1', '--out', out,
        '--bags', 'symlink',
    )
    assert (done.returncode, done.stderr) == (0, '')
    pd.testing.assert_frame_equal(compared(out), whole)
    assert taxinet('doctor', out).returncode == 0
    bag = next(out.glob('nominal-*'))
    assert bag.is_symlink()
    assert taxinet('bag', 'info', bag).returncode == 0
