"""Every command that is refused, in ``tests/data/refusals.txt``: one line, code 2, nothing left.

A block of the file is the command, then its line on standard error; a line that ends in … goes on
with a list that grows. Paths of ``bags/`` are those of this source tree.
"""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
REFUSALS = Path(__file__).resolve().parents[1] / 'data' / 'refusals.txt'
BLOCKS = [block.splitlines() for block in REFUSALS.read_text(encoding='utf-8').split('\n\n')]


def test_given_the_file_then_no_command_is_in_it_twice():
    assert len({command for command, _ in BLOCKS}) == len(BLOCKS) > 90


@pytest.mark.ros
@pytest.mark.parametrize(('command', 'line'), BLOCKS, ids=[command for command, _ in BLOCKS])
def test_given_a_mistake_then_one_line_says_what_and_nothing_is_left_behind(
    command, line, taxinet, tmp_path
):
    name, *words = shlex.split(command)
    assert name == 'taxinet'
    words = [f'{ROOT}/{word}' if word.startswith('bags/') else word for word in words]
    code, out, err = taxinet(*words)
    assert (code, out, err.count('\n')) == (2, '', 1)
    err = err.removeprefix('taxinet: error: ').replace(f'{ROOT}/', '').removesuffix('\n')
    start = line.removesuffix('…')
    assert start != ''
    assert (err[:len(start)] if line != start else err) == start
    assert list(tmp_path.iterdir()) == []
