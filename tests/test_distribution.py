"""What is given to others: source distribution, citation, declaration of quality, the Makefile."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
import yaml

import taxinet_ros
from taxinet_ros.cli.messages import message_sources
from taxinet_ros.errors import UsageError

ROOT = Path(__file__).resolve().parent.parent


BUILD = """
import sys
import setuptools
from distutils.core import run_setup

out = sys.argv[1]
done = run_setup('setup.py', ['-q'], stop_after='config')
for command, options in {
    'build': {'build_base': f'{out}/build'}, 'egg_info': {'egg_base': out},
    'bdist_wheel': {'bdist_dir': f'{out}/bdist', 'dist_dir': out, 'skip_build': 1},
    'sdist': {'dist_dir': out},
}.items():
    done.get_option_dict(command).update({name: ('test', value) for name, value in options.items()})
for command in ('build_py', 'bdist_wheel', 'sdist'):
    done.run_command(command)
"""
"""Builds both but compiles nothing: that the module is compiled, the build by colcon tells."""
SHARED = ('config', 'launch', 'msg_defs', 'scenarios')


def files(*patterns: str) -> set[str]:
    return {
        str(path.relative_to(ROOT)) for pattern in patterns for path in ROOT.glob(pattern)
        if path.is_file() and path.suffix not in ('.so', '.pyc')
    }


@pytest.fixture(scope='module')
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source distribution."""
    folder = tmp_path_factory.mktemp('built')
    done = subprocess.run(
        [sys.executable, '-c', BUILD, folder], cwd=ROOT, capture_output=True, text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_given_the_source_distribution_then_it_has_all_that_builds_installs_and_is_read(built):
    with tarfile.open(next(built.glob('*.tar.gz'))) as archive:
        packed = {one.name.partition('/')[2] for one in archive.getmembers() if one.isfile()}
    wanted = files(
        'taxinet_ros/**/*', 'ros2taxinet.py', 'scripts/*', 'resource/*', 'package.xml', 'setup.py',
        'pyproject.toml',
        'constraints*.txt', 'LICENSE', 'CITATION.cff', 'QUALITY_DECLARATION.md', 'CHANGELOG.rst',
        'README.md', 'MANIFEST.in', *(f'{folder}/**/*' for folder in SHARED),
    )
    assert len(wanted) > 500
    assert sorted(wanted - packed) == []
    of_the_tool = {'PKG-INFO', 'setup.cfg'}
    messages = {name for name in packed if name.startswith('taxinet_ros/bag/share/')}
    assert len(messages) == len(files('msg_defs/msg/*'))
    assert sorted(packed - wanted - of_the_tool - messages) == [], 'nor tests, caches or results'


def test_given_the_wheel_then_it_has_every_file_that_is_used_and_nothing_else(built):
    with zipfile.ZipFile(next(built.glob('*.whl'))) as wheel:
        packed = set(wheel.namelist())
        points = wheel.read(next(name for name in packed if name.endswith('/entry_points.txt')))
    data = f'taxinet_ros-{taxinet_ros.__version__}.data'
    code = {
        name for name in files('taxinet_ros/**/*', 'ros2taxinet.py')
        if not name.endswith(('.cpp', '.hpp'))
    } | {f'taxinet_ros/bag/share/taxinet_msgs/{name}' for name in
         (Path(path).relative_to('msg_defs').as_posix() for path in files('msg_defs/msg/*'))}
    shared = {f'{data}/data/share/taxinet_ros/{name}' for name in files(
        'package.xml', *(f'{folder}/**/*' for folder in SHARED))}
    others = {
        *(f'{data}/data/lib/taxinet_ros/{Path(name).name}' for name in files('scripts/*')),
        f'{data}/data/share/ament_index/resource_index/packages/taxinet_ros',
    }
    for name in (
        'taxinet_ros/core/perception/weights/taxinet.safetensors', 'taxinet_ros/py.typed',
        'taxinet_ros/analysis/report/assets/page.css', 'taxinet_ros/nodes/dds.xml',
        'taxinet_ros/core/rig/models/caravan/caravan.xml',
    ):
        assert name in code
    wanted = code | shared | others
    about = {name for name in packed if '.dist-info/' in name}
    assert sorted(wanted - packed) == []
    assert sorted(packed - wanted - about) == [], 'nor tests, caches or results'
    assert {Path(name).name for name in about} == {
        'METADATA', 'WHEEL', 'RECORD', 'LICENSE', 'entry_points.txt', 'top_level.txt'}
    assert b'[console_scripts]\ntaxinet = taxinet_ros.cli.start:main\n' in points
    assert b'[ros2cli.command]\ntaxinet = ros2taxinet:TaxinetCommand\n' in points


def test_given_the_installation_then_the_messages_can_be_built_from_it_alone(monkeypatch, tmp_path):
    share = Path(sys.prefix) / 'share' / 'taxinet_ros' / 'msg_defs'
    for path in files('msg_defs/**/*'):
        assert (share.parent / path).is_file(), path
    assert message_sources(tmp_path) == ROOT / 'msg_defs', 'a checkout has the newest'
    monkeypatch.setattr(taxinet_ros, '__file__', str(tmp_path / 'taxinet_ros' / '__init__.py'))
    assert message_sources(Path(sys.prefix)) == share
    with pytest.raises(UsageError, match='install taxinet_ros anew'):
        message_sources(tmp_path)


def test_given_the_citation_then_it_has_what_its_format_requires_and_the_version_of_the_package():
    told = yaml.safe_load((ROOT / 'CITATION.cff').read_text())
    assert {'cff-version', 'message', 'title', 'authors'} <= {*told}
    assert told['cff-version'] == '1.2.0'
    assert all('name' in author or 'family-names' in author for author in told['authors'])
    assert told['version'] == taxinet_ros.__version__
    assert f'<version>{told["version"]}</version>' in (ROOT / 'package.xml').read_text()
    assert told['license'] in (ROOT / 'package.xml').read_text()


def test_given_the_declaration_of_quality_then_it_answers_every_chapter_of_rep_2004():
    text = (ROOT / 'QUALITY_DECLARATION.md').read_text()
    assert '**quality level 4**' in text
    for chapter in ('Version policy', 'Change control', 'Documentation', 'Testing', 'Dependencies',
                    'Platforms', 'Security'):
        assert chapter in text


@pytest.mark.parametrize(('python', 'words'), [
    ('/bin/false', '/bin/false ended with exit code 1: it says nothing; name a Python'),
    ('/nowhere/python', 'exit code 127'),
    ('/bin/echo', '/bin/echo ended with exit code 0'),
])
def test_given_an_interpreter_that_is_none_then_make_shows_its_own_words(python, words, tmp_path):
    done = subprocess.run(
        ['make', '-s', f'PYTHON={python}', f'VENV={tmp_path / "v"}', 'asked-python'],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )
    assert done.returncode == 2
    first = done.stderr.splitlines()[0]
    assert words in first
    assert 'make PYTHON=/path/to/python3.12' in first


def test_given_the_words_of_a_launcher_then_make_shows_all_of_them_and_of_a_traceback_the_end(
    tmp_path,
):
    """As pyenv's, whose last line says nothing; nor does the first of a traceback."""
    for told, shown in (
        ('pyenv: no such command\n\nNote: see the help\n      of it.',
         'pyenv: no such command Note: see the help of it.;'),
        ('Traceback (most recent call last):\n  File "x"\nImportError: no venv',
         'exit code 3: ImportError: no venv;'),
    ):
        python = tmp_path / 'python'
        python.write_text(f"#!/bin/sh\ncat >&2 <<'END'\n{told}\nEND\nexit 3\n")
        python.chmod(0o755)
        done = subprocess.run(
            ['make', '-s', f'PYTHON={python}', f'VENV={tmp_path / "v"}', 'asked-python'],
            cwd=ROOT, capture_output=True, text=True, check=False,
        )
        assert done.returncode == 2
        assert shown in done.stderr.splitlines()[0]


def test_given_the_container_then_every_step_copies_what_there_is_and_ends_in_a_run():
    lines = (ROOT / 'Containerfile').read_text().splitlines()
    steps = [line for line in lines if line and not line.startswith('#')]
    assert steps[0].startswith('FROM docker.io/library/python:3.12')
    assert any(step == 'RUN make' for step in steps)
    assert steps[-1].startswith('CMD ')


def test_given_what_git_ignores_then_no_image_gets_it_either():
    """Above all no .venv, whose marks would have make install nothing."""
    ignored, left_out = (
        {line.strip('/').removeprefix('**/') for line in (ROOT / name).read_text().splitlines()
         if line and not line.startswith('#')} for name in ('.gitignore', '.dockerignore'))
    assert len(ignored) > 10
    assert left_out == ignored | {'.git'}
    assert not (ROOT / '.containerignore').exists(), 'Podman would read it, and Docker would not'


CONTAINER = """\
# A comment.
FROM docker.io/library/none
WORKDIR /opt/it
COPY . .
RUN mkdir -p .venv/bin && printf '#!/bin/sh\\necho said "$@"\\n' > .venv/bin/it
RUN chmod +x .venv/bin/it
RUN cat; ls; echo one > made
ENV PATH=/opt/it/.venv/bin:$PATH
WORKDIR /work
CMD ["it", "--help me"]
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with the script and a small Containerfile."""
    folder = tmp_path / 'checkout'
    (folder / '.ci').mkdir(parents=True)
    shutil.copy(ROOT / '.ci' / 'container_steps', folder / '.ci')
    (folder / 'Containerfile').write_text(CONTAINER)
    (folder / '.gitignore').write_text('ignored\n')
    (folder / 'ignored').touch()
    (folder / 'a file').touch()
    subprocess.run(['git', 'init', '-q', folder], check=True)
    return folder


def container_steps(checkout: Path) -> subprocess.CompletedProcess[str]:
    place = checkout.parent / 'copies'
    place.mkdir()
    done = subprocess.run(
        [checkout / '.ci' / 'container_steps'], input='not for them', capture_output=True,
        text=True, env={**os.environ, 'TMPDIR': str(place)}, check=False,
    )
    assert list(place.iterdir()) == [], 'the copy is gone'
    return done


def test_given_no_container_engine_then_the_script_does_what_the_containerfile_says(checkout):
    done = container_steps(checkout)
    assert (done.returncode, done.stderr) == (0, '')
    lines = done.stdout.splitlines()
    assert [line for line in lines if line.startswith(('step: ', 'command: '))] == [
        line.replace('RUN', 'step:').replace('CMD', 'command:')
        for line in CONTAINER.splitlines() if line.startswith(('RUN ', 'CMD '))]
    assert lines[-1] == 'said --help me', 'found on the PATH that the file sets'
    assert 'a file' in lines
    assert 'ignored' not in lines
    assert 'not for them' not in done.stdout
    assert not (checkout / 'made').exists(), 'it works in a copy'


@pytest.mark.parametrize(('step', 'code', 'told'), [
    ('RUN exit 7', 7, ''), ('USER nobody', 2, 'says USER, which this script does not know'),
])
def test_given_a_step_that_fails_or_is_not_known_then_the_script_ends_there(
    checkout, step, code, told
):
    (checkout / 'Containerfile').write_text(f'FROM x\n{step}\nRUN echo after\n')
    done = container_steps(checkout)
    assert done.returncode == code
    assert told in done.stderr
    assert 'after' not in done.stdout
