"""Scenario files that are wrong, hostile or endless, in the child: one line each, no more."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from fuzz_mutations import ROUNDS, mutants

from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import shipped_folder
from taxinet_ros.scenes.source import Rejected, SceneSource

pytestmark = pytest.mark.nightly

MUTANTS = 20
TIMEOUT_S = 20.0
PLANE = 'model runway_world\nego = new Plane at (Range(-1, 1), 400)\n'
LINE = 3000
"""Most characters of an error's line."""

HOSTILE = {
    'ends': 'import os\nos._exit(0)\n',
    'ends with its pipes': 'import os\nos.closerange(3, 40)\n',
    'crashes': 'import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n',
    'prints without end': 'print("x" * 30_000_000)\nraise ValueError("x" * 300_000_000)\n',
    'says nonsense': 'import os\nfor fd in range(3, 64):\n    try:\n'
                     '        os.write(fd, b"nonsense\\n")\n    except OSError:\n        pass\n',
    'recurses': 'def f(x):\n    return f(x + 1) + 1\nf(0)\n',
    'hogs': 'hog = [bytes(1 << 30) for _ in range(64)]\n',
    'opens what is not there': 'open("/nowhere/at/all")\n',
    'nested': 'x = ' + '(' * 5000 + '\n',
    'null': 'x = "\0"\n',
    'no text': '\udcff',
}


@pytest.fixture(scope='module')
def source() -> Iterator[SceneSource]:
    """One child for all that leave it alive: importing Scenic takes a second."""
    with SceneSource('nominal', seed=1, timeout_s=TIMEOUT_S) as started:
        yield started


def end_of(source: SceneSource, program: Path) -> str:
    """How a program ends; a child that it has taken along is replaced."""
    try:
        source._ask({'op': 'compile', 'program': str(program)})
        source.scene(0)
    except Rejected:
        return 'rejected'
    except UsageError as error:
        if source._child is None:
            source.__enter__()
        return refused(error)
    return 'drawn'


def refused(error: UsageError) -> str:
    assert len(str(error).splitlines()) == 1
    assert len(str(error)) < LINE
    return 'refused'


@pytest.mark.parametrize('name', HOSTILE)
def test_given_a_hostile_program_when_drawn_then_it_is_refused_in_one_line(
    name: str, source: SceneSource, tmp_path: Path
) -> None:
    path = tmp_path / 'hostile.scenic'
    path.write_bytes((PLANE + HOSTILE[name]).encode(errors='surrogateescape'))
    assert end_of(source, path) == 'refused'
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.timeout(3600 * ROUNDS)
def test_given_mutants_of_the_shipped_programs_when_drawn_then_refused_in_one_line_or_drawn(
    source: SceneSource, tmp_path: Path
) -> None:
    corpus = [(shipped_folder() / f'{name}.scenic').read_bytes()
              for name in ('nominal', 's_falsif', 'runway_position')]
    path = tmp_path / 'mutant.scenic'
    ends = Counter[str]()
    for data in mutants(corpus, MUTANTS, seed=3, text=True):
        path.write_bytes(data)
        ends[end_of(source, path)] += 1
    assert ends['refused'] > MUTANTS // 4
    assert sum(ends.values()) == MUTANTS * ROUNDS
