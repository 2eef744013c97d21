"""What is given to others: source distribution, citation, declaration of quality, the Makefile."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
import yaml

import taxinet_ros
from taxinet_ros.cli.messages import message_sources
from taxinet_ros.errors import UsageError

ROOT = Path(__file__).resolve().parent.parent


def files(*patterns: str) -> set[str]:
    return {
        str(path.relative_to(ROOT)) for pattern in patterns for path in ROOT.glob(pattern)
        if path.is_file() and path.suffix not in ('.so', '.pyc')
    }


def test_given_the_source_distribution_then_it_has_all_that_builds_installs_and_is_read(tmp_path):
    done = subprocess.run(
        [sys.executable, 'setup.py', '-q', 'egg_info', '-e', tmp_path, 'sdist', '-d', tmp_path],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stderr
    with tarfile.open(next(tmp_path.glob('*.tar.gz'))) as archive:
        packed = {name.partition('/')[2] for name in archive.getnames()}
    wanted = files(
        'taxinet_ros/**/*', 'scenarios/**/*', 'msg_defs/**/*', 'launch/*', 'config/*', 'scripts/*',
        'resource/*', 'package.xml', 'setup.py', 'pyproject.toml', 'constraints.txt', 'LICENSE',
        'CITATION.cff', 'QUALITY_DECLARATION.md', 'CHANGELOG.rst',
    )
    assert len(wanted) > 500
    assert sorted(wanted - packed) == []


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


def test_given_the_container_then_every_step_copies_what_there_is_and_ends_in_a_run():
    lines = (ROOT / 'Containerfile').read_text().splitlines()
    steps = [line for line in lines if line and not line.startswith('#')]
    assert steps[0].startswith('FROM docker.io/library/python:3.12')
    assert any(step == 'RUN make' for step in steps)
    assert steps[-1].startswith('CMD ')
