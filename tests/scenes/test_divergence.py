"""Every way of drawing scenes gives those that Scenic's own ``generate()`` gives."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.nightly

_SCRIPT = Path(__file__).with_name('divergence.py')
_LEVEL = 1e-3
_DRAWS = 150
"""Of each program and way; the script by itself takes 2,000 of each of its programs."""

PROGRAMS = ('hard, on two', 'soft, two', 'nested, shared', 'normal, random mean',
            'region, required', 'partly marked')


@pytest.fixture(scope='module')
def found() -> dict[str, Any]:
    """P-values, from a process of its own: it puts words in place of Scenic's."""
    command = [sys.executable, str(_SCRIPT), '--json', '--draws', str(_DRAWS), '--programs']
    done = subprocess.run([*command, *PROGRAMS], capture_output=True, text=True, check=True)
    values: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return values


def smallest(ways: dict[str, dict[str, float]]) -> dict[str, float]:
    return {way: min(values.values()) for way, values in ways.items()}


def test_s3_given_programs_of_many_kinds_when_drawn_then_no_way_differs_from_scenic(
    found: dict[str, Any],
) -> None:
    right = found['right']
    assert list(right) == list(PROGRAMS)
    tests = sum(len(values) for ways in right.values() for values in ways.values())
    assert tests > 80
    assert {name: smallest(ways) for name, ways in right.items()
            if min(smallest(ways).values()) < _LEVEL / tests} == {}
    assert all(list(ways) == ['run', 'random', 'halton', 'ce'] for ways in right.values())


def test_s3_given_a_wrong_program_when_compared_then_the_difference_is_seen(
    found: dict[str, Any],
) -> None:
    """Another share of a soft requirement among them, as a redrawn activation would give."""
    wrong = found['wrong']
    assert set(wrong) >= {'another share', 'a wider normal', 'independent', 'redrawn activation'}
    assert all(min(smallest(ways).values()) < 1e-4 for ways in wrong.values()), wrong
