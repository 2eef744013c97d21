"""Mutants for native libraries behind our readers, each target in a process that may be lost."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from fuzz_mutations import ROUNDS

from taxinet_ros.nodes.running.domain import own_domain

pytestmark = pytest.mark.nightly

CHILD = Path(__file__).with_name('fuzz_child.py')
MUTANTS = {'onnx': 150, 'table': 60, 'parameters': 60}


@pytest.mark.parametrize('target', MUTANTS)
@pytest.mark.timeout(3600 * ROUNDS)
def test_given_mutants_when_read_in_a_process_then_it_lives_and_says_one_line_about_each(
    target: str, tmp_path: Path
) -> None:
    with own_domain() as domain:
        child = subprocess.run(
            [sys.executable, str(CHILD), target, str(tmp_path), str(MUTANTS[target]), '7'],
            capture_output=True, text=True, cwd=tmp_path,
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
        )
    ends = Counter(child.stdout.splitlines())
    words = f'{child.returncode}, {ends}, {tmp_path}/last:\n{child.stderr[-3000:]}'
    assert ends['whole end'] == 1, words
    assert ends['sound ok'] == 1, words
    assert ends['mutant UsageError'] + ends['mutant ok'] == MUTANTS[target] * ROUNDS
    assert ends['mutant UsageError'] > MUTANTS[target] // 4
