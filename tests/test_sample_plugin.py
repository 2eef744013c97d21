"""The sample package of docs/extending.md: installed by pip, checked, and used by its names."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from taxinet_ros.trials.record.facts import read_facts

REPOSITORY = Path(__file__).resolve().parent.parent
PLUGIN = REPOSITORY / 'examples' / 'plugin'
PAGE = (REPOSITORY / 'docs' / 'extending.md').read_text(encoding='utf-8')
MINE = ('--perception', 'bright-paint', '--controller', 'damped', '--spec', 'gentle')


@pytest.fixture(scope='module')
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package alone in a folder; pip leaves build folders beside what it builds."""
    folder = tmp_path_factory.mktemp('plugin')
    source = shutil.copytree(PLUGIN, folder / 'source')
    subprocess.run(
        [sys.executable, '-m', 'pip', 'install', '-q', '--no-index', '--no-deps',
         '--no-build-isolation', '--disable-pip-version-check', '--target', folder / 'site',
         source],
        check=True, capture_output=True,
    )
    return folder / 'site'


def python(site: Path, *words: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *map(str, words)], capture_output=True, text=True, cwd=cwd,
        env={**os.environ, 'PYTHONPATH': str(site), 'COLUMNS': '80'},
    )


def taxinet(site: Path, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return python(site, '-c', 'from taxinet_ros.cli.main import main; main()', *words, cwd=cwd)


@pytest.mark.nightly
def test_given_the_page_when_its_check_of_the_sample_is_run_then_it_passes(
    site: Path, tmp_path: Path
) -> None:
    [code] = re.findall(r'```python\n(.*?)```', PAGE, re.DOTALL)
    done = python(site, '-c', f'{code}\ntest_contracts()', cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, '')


def test_given_the_page_then_the_entry_points_that_it_shows_are_those_of_the_sample() -> None:
    [shown] = re.findall(r'```toml\n(.*?)```', PAGE, re.DOTALL)
    told = tomllib.loads((PLUGIN / 'pyproject.toml').read_text())
    assert tomllib.loads(shown)['project']['entry-points'] == told['project']['entry-points']


def test_given_the_sample_when_its_names_are_given_then_a_run_is_made_and_says_whose_they_are(
    site: Path, tmp_path: Path
) -> None:
    done = taxinet(
        site, 'run', 'nominal', *MINE, '--set', 'duration=1', '--runs', '1', '--out', 'c',
        cwd=tmp_path,
    )
    assert done.returncode in (0, 1), done.stderr
    facts = read_facts(tmp_path / 'c')
    assert list(facts['specs']) == ['gentle']
    for kind, name in (('perceptions', 'bright-paint'), ('controllers', 'damped')):
        found = facts['extensions'][kind]
        assert (found['name'], found['distribution']) == (name, 'taxinet-sample')
        assert found['version'] == '0.1.0'
        assert len(found['sha256']) == 64
    assert facts['controller_sha256'] == facts['extensions']['controllers']['sha256']
    [stack] = facts['stacks'].values()
    assert stack['plugins'] == 'taxinet-sample 0.1.0'
    [bag] = [path for path in (tmp_path / 'c').iterdir() if path.is_dir()]
    told = taxinet(site, 'bag', 'info', str(bag), cwd=tmp_path)
    assert 'bright-paint' in told.stdout
    assert 'damped' in told.stdout
    # Its own perception and controller are known by their names, so it can be made once more.
    again = taxinet(site, 'run', '--from', str(bag), cwd=tmp_path)
    assert again.returncode == 0, again.stdout + again.stderr
    # Its own command reads the bag.
    turned = taxinet(site, 'turns', str(bag), cwd=tmp_path)
    assert turned.returncode == 0, turned.stderr
    assert re.fullmatch(r'\S+: \d+\.\d deg\n', turned.stdout)


@pytest.mark.nightly
def test_given_the_sample_when_its_sampler_is_named_then_it_chooses_the_runs(
    site: Path, tmp_path: Path
) -> None:
    options = ('falsify', 's_falsif', '--sampler', 'corners', '--sampler-option', 'width=0.05',
               '--perception', 'truth', '--set', 'duration=1', '--out', 'f')
    done = taxinet(site, *options, '--runs', '3', cwd=tmp_path)
    assert done.returncode in (0, 1), done.stderr
    facts = read_facts(tmp_path / 'f')
    assert facts['extensions']['samplers']['name'] == 'corners'
    more = taxinet(site, *options, '--runs', '4', '--resume', cwd=tmp_path)
    assert more.returncode in (0, 1), more.stderr
    with changed_text(site / 'taxinet_sample.py', lambda text: f'{text}\n# changed\n'):
        changed = taxinet(site, *options, '--runs', '5', '--resume', cwd=tmp_path)
    assert changed.returncode == 2
    told = facts['extensions']['samplers']['sha256'][:12]
    assert (f'f was begun with sampler corners of taxinet-sample 0.1.0 (sha256 {told}…), which is '
            'now of taxinet-sample 0.1.0 (sha256 ') in changed.stderr
    assert changed.stderr.count(told) == 1
    gone = taxinet(tmp_path, *options, '--runs', '5', '--resume', cwd=tmp_path)
    assert gone.returncode == 2
    assert (f'in f it was sampler corners of taxinet-sample 0.1.0 (sha256 {told}…), which is not '
            'installed any more') in gone.stderr


@contextlib.contextmanager
def changed_text(path: Path, change: Callable[[str], str]) -> Iterator[None]:
    """A file of the package as it is not meant to be; afterwards it is as before."""
    before = path.read_text()
    path.write_text(change(before))
    try:
        yield
    finally:
        path.write_text(before)


@pytest.mark.nightly
def test_given_the_sample_when_a_run_is_made_in_its_world_then_its_frames_are_of_there(
    site: Path, tmp_path: Path
) -> None:
    code = """
from taxinet_ros.trials.record.facts import read_facts
import taxinet_ros as tx
scene = tx.Scenario(cross_track_m=2.0, duration_s=1.0)
here, there = (tx.run(scene, specs="gentle", world=world) for world in ("kmwh", "bicycle"))
assert list(there.trace.cte_m) != list(here.trace.cte_m)
assert there.frame(10).tobytes() != here.frame(10).tobytes()
assert [frame.tobytes() for frame in there.frames()][10] == there.frame(10).tobytes()
assert (there.steps[1].observation.state.z_m, list(there.rho)) == (1.55, ["gentle"])
"""
    done = python(site, '-c', code, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, '')


@pytest.mark.nightly
def test_given_the_world_of_the_sample_when_runs_are_asked_for_then_all_that_follows_is_of_there(
    site: Path, tmp_path: Path
) -> None:
    options = ('falsify', 'nominal', '--world', 'bicycle', '--perception', 'truth', '--spec',
               'always(abs(cte) <= 0.01 m)', '--sampler', 'random', '--set', 'duration=1',
               '--set', 'cross_track=2', '--out', 'f')
    done = taxinet(site, *options, '--runs', '1', cwd=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr
    assert 'world bicycle' in done.stdout
    facts = read_facts(tmp_path / 'f')
    assert facts['world'] == facts['extensions']['worlds']['name'] == 'bicycle'
    [bag] = [path for path in (tmp_path / 'f').iterdir() if (path / 'metadata.yaml').exists()]
    info = taxinet(site, 'bag', 'info', str(bag), cwd=tmp_path)
    assert 'world      bicycle of taxinet-sample 0.1.0, sha256 ' in info.stdout
    elsewhere = [word for word in options if word not in ('--world', 'bicycle')]
    other = taxinet(site, *elsewhere, '--runs', '2', '--resume', cwd=tmp_path)
    assert other.returncode == 2
    assert 'was begun with world "bicycle", not "kmwh"' in other.stderr
    more = taxinet(site, *options, '--runs', '2', '--resume', '--workers', '2', cwd=tmp_path)
    assert more.returncode == 1, more.stdout + more.stderr
    # Made once more: in its own world, of which the bag tells.
    again = taxinet(site, 'run', '--from', str(bag), cwd=tmp_path)
    assert again.returncode == 0, again.stdout + again.stderr
    shrunk = taxinet(site, 'shrink', str(bag), '--runs', '8', '--out', 's', cwd=tmp_path)
    assert '--world bicycle' in shrunk.stdout, shrunk.stdout + shrunk.stderr
    assert read_facts(tmp_path / 's')['world'] == 'bicycle'
    why = taxinet(site, 'localize', 'f', '--workers', '1', cwd=tmp_path)
    assert why.returncode in (0, 1), why.stdout + why.stderr
    assert 'another one' not in why.stdout


@pytest.mark.nightly
def test_given_a_world_where_it_has_no_effect_then_it_is_refused_by_name(
    site: Path, tmp_path: Path
) -> None:
    done = taxinet(site, 'run', '--from', 'bag', '--world', 'bicycle', cwd=tmp_path)
    assert (done.returncode, '--world is taken from the bag' in done.stderr) == (2, True)
    for command in ('run', 'falsify', 'up'):
        words = () if command == 'up' else ('nominal',)
        done = taxinet(site, command, *words, '--world', 'mars', cwd=tmp_path)
        assert done.returncode == 2
        told = ' '.join(done.stderr.split())
        assert "world: 'mars' is unknown; known: kmwh, xplane, bicycle" in told


def test_given_a_typo_when_the_sample_is_installed_then_its_names_are_among_the_known(
    site: Path, tmp_path: Path
) -> None:
    done = taxinet(site, 'run', 'nominal', '--perception', 'bright', cwd=tmp_path)
    assert done.returncode == 2
    said = ' '.join(done.stderr.split())
    assert 'iterative-learned, bright-paint' in said
    assert 'packages add more by taxinet_ros.perceptions' in said


@pytest.mark.nightly
def test_given_a_broken_package_when_not_named_then_all_else_goes_on(
    site: Path, tmp_path: Path
) -> None:
    broken = shutil.copytree(site, tmp_path / 'site')
    (broken / 'taxinet_sample.py').write_text('import no_such_module\n')
    done = taxinet(broken, 'run', 'nominal', *MINE, cwd=tmp_path)
    assert done.returncode == 2
    [line] = done.stderr.splitlines()
    assert 'of taxinet-sample 0.1.0' in line
    assert "No module named 'no_such_module'" in line
    fine = taxinet(
        broken, 'run', 'nominal', '--perception', 'truth', '--set', 'duration=0.5', '--runs', '1',
        '--out', 'c', cwd=tmp_path,
    )
    assert fine.returncode in (0, 1), fine.stderr
    assert taxinet(broken, 'falsify', '--help', cwd=tmp_path).returncode == 0
    assert '\n  turns  ' in taxinet(broken, '--help', cwd=tmp_path).stdout
    turns = taxinet(broken, 'turns', cwd=tmp_path)
    assert (turns.returncode, turns.stderr.count('\n')) == (2, 1)
    assert 'command turns of taxinet-sample 0.1.0: ' in turns.stderr
