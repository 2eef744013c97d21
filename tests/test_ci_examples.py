"""The examples for CI are scripts that run, and the hook for pre-commit is a command."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pandas as pd
import pytest
import typer
import yaml

from taxinet_ros.cli.main import app

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / 'examples' / 'ci'
INSTALLS = re.compile(r'^(git clone|make -C|echo /tmp|export PATH)')
TINY = {
    'NETWORK': 'truth', 'BASELINE': 'baseline.parquet', 'CHECK_SCENES': '1',
    'MIN_SATISFACTION': '0.01',
}


def github() -> tuple[dict[str, Any], list[str]]:
    """Variables and script lines, those that install left out."""
    told = yaml.safe_load((FOLDER / 'github-actions.yml').read_text())
    (job,) = told['jobs'].values()
    assert next(step['name'] for step in job['steps'] if 'run' in step) == 'install'
    lines = [line for step in job['steps'] if 'run' in step
             for line in step['run'].splitlines()]
    return told['env'], lines


def gitlab() -> tuple[dict[str, Any], list[str]]:
    told = yaml.safe_load((FOLDER / '.gitlab-ci.yml').read_text())
    assert told['gate']['artifacts']['reports'] == {'junit': 'gate.xml'}
    return told['variables'], [*told['gate']['before_script'], *told['gate']['script']]


def test_given_both_examples_then_they_have_the_same_variables_and_the_same_script():
    scripts = []
    for variables, lines in (github(), gitlab()):
        assert {*variables} == {*TINY}
        installing = [line for line in lines if INSTALLS.match(line)]
        assert len(installing) == 3
        assert any('make -C' in line for line in installing)
        scripts.append([line for line in lines if line not in installing])
    assert scripts[0] == scripts[1]
    assert [line.split()[:2] for line in scripts[0]] == [['taxinet', 'check'], ['taxinet', 'gate']]


@pytest.mark.nightly
def test_given_the_script_when_run_with_a_tiny_budget_then_it_leaves_what_is_uploaded(tmp_path):
    table = pd.read_parquet(ROOT / 'bags' / 's_falsif_truth_400.parquet')
    table.iloc[:2].assign(duration_s=12.0).to_parquet(tmp_path / 'baseline.parquet')
    _, lines = gitlab()
    script = '\n'.join(line for line in lines if not INSTALLS.match(line))
    done = subprocess.run(
        ['bash', '-e', '-c', script], cwd=tmp_path, text=True, capture_output=True, check=False,
        env={**os.environ, **TINY,
             'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'},
    )
    # Two scenes show nothing of a baseline: not clear, so a job does not pass.
    assert done.returncode == 3, done.stderr
    assert 'truth: 1 satisfied, 0 violated, 0 unclear of 1 scenes' in done.stdout
    assert 'INCONCLUSIVE: gated (2 PASS)' in done.stdout
    (suite,) = ElementTree.parse(tmp_path / 'gate.xml').getroot()
    assert [case.get('name') for case in suite.findall('testcase')] == [
        'satisfied >= 0.01', 'no worse than the baseline, margin 0.05',
        'runs broken by the bench: at most 0']
    assert len(pd.read_parquet(tmp_path / 'gated' / 'runs.parquet')) == 2


def test_given_the_hook_of_pre_commit_then_its_entry_is_a_command_that_takes_files():
    (hook,) = yaml.safe_load((ROOT / '.pre-commit-hooks.yaml').read_text())
    assert {'id', 'name', 'entry', 'language', 'files'} <= {*hook}
    program, name, *words = shlex.split(hook['entry'])
    assert program == 'taxinet'
    command = typer.main.get_command(app).commands[name]
    found = command.make_context(name, [*words, 'one.onnx', 'two.onnx']).params
    assert (found['networks'], found['quiet']) == (['one.onnx', 'two.onnx'], True)
    for file in ('my_net.onnx', 'weights/taxinet.safetensors'):
        assert re.search(hook['files'], file)
