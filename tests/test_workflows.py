"""The workflows: valid, and what they run is a script or a target that is there."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
WORKFLOWS = sorted((ROOT / '.github' / 'workflows').glob('*.yml'))


def steps(path: Path) -> list[dict]:
    """Every step of a workflow."""
    return [step for job in yaml.safe_load(path.read_text())['jobs'].values()
            for step in job['steps']]


@pytest.mark.parametrize('path', WORKFLOWS, ids=lambda path: path.stem)
def test_given_a_workflow_then_each_command_is_one_of_ours(path):
    commands = [step['run'] for step in steps(path) if 'run' in step]
    assert commands
    targets = set(re.findall(r'^([\w ]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))
    for program, *words in map(str.split, commands):
        if program == 'make':
            assert words[0] in ' '.join(targets).split()
        else:
            script = ROOT / program
            assert script.stat().st_mode & 0o100
            subprocess.run(['bash', '-n', script], check=True)


def test_given_the_workflows_then_they_are_these_and_have_a_badge_each():
    assert [path.stem for path in WORKFLOWS] == ['docs', 'ros', 'test', 'wheel']
    text = (ROOT / 'CONTRIBUTING.md').read_text()
    for path in WORKFLOWS:
        assert f'actions/workflows/{path.name}/badge.svg' in text
    matrices = [yaml.safe_load((ROOT / f'.github/workflows/{name}.yml').read_text())['jobs'][name][
        'strategy']['matrix'] for name in ('test', 'wheel', 'ros')]
    pythons = {'python': ['3.11', '3.12', '3.13']}
    assert matrices == [pythons, pythons, {'distribution': ['jazzy', 'lyrical']}]


@pytest.mark.skipif(shutil.which('actionlint') is None, reason='actionlint is not installed')
def test_given_actionlint_then_it_has_nothing_to_say():
    done = subprocess.run(['actionlint', *WORKFLOWS], cwd=ROOT, capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stdout
