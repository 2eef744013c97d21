"""Other people's monitors beside ours: in their own environment, in turns with everything else."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO

from taxinet_ros.bench.measure import Subject
from taxinet_ros.bench.monitor import LAST, swinging_run
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.types import NS_PER_S

_CHILD = Path(__file__).with_name('peers_child.py')
_FORMULAS = {'phi_always': 'G near', 'phi_eventually': 'F[0, 10] G near'}
_SLOW = 'py-mtl'
"""metric-temporal-logic takes a second and more."""


@contextmanager
def peer_subjects(python: str) -> Iterator[list[Subject]]:
    """Subjects of the monitors that another Python has; it runs until the context is left.

    Args:
        python: its executable, of an environment made from ``tests/core/mtl/oracles.txt``.

    Raises:
        UsageError: no such Python, or it has none of the monitors.
    """
    try:
        child = subprocess.Popen(
            [python, str(_CHILD)], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
    except OSError as error:
        raise UsageError(f'bench: --peers: cannot run {python}: {error.strerror}') from None
    with child:
        assert child.stdin is not None, 'a pipe was asked for'
        assert child.stdout is not None, 'a pipe was asked for'
        answer = _ask(child.stdin, child.stdout, _trace())
        names = json.loads(answer) if answer else []
        if not names:
            raise UsageError(
                f'bench: --peers: {python} has no rtamt, sentil or metric-temporal-logic; '
                'tests/core/mtl/oracles.txt says how to install them'
            )
        yield [_subject(name, child.stdin, child.stdout) for name in names]


def _trace() -> str:
    run = swinging_run(LAST)
    return json.dumps(
        {
            'times_s': [stamp_ns / NS_PER_S for stamp_ns, _ in run],
            'cte_m': [sample['cte'] for _, sample in run],
            'formulas': {name: [SHIPPED[name].text, text] for name, text in _FORMULAS.items()},
        }
    )


def _subject(name: str, questions: IO[str], answers: IO[str]) -> Subject:
    # The other process takes its time itself, so that of talking to it does not count.
    run = partial(_measure, name, questions, answers)
    slow = name.startswith(_SLOW)
    return Subject(name='monitor', run=run, warm_ups=0 if slow else 2, most=3 if slow else None)


def _measure(name: str, questions: IO[str], answers: IO[str]) -> dict[str, int]:
    answer = _ask(questions, answers, name)
    if not answer:
        raise UsageError(f'bench: --peers: {name} broke down; its Python says why above')
    return {name: int(answer)}


def _ask(questions: IO[str], answers: IO[str], line: str) -> str:
    try:
        questions.write(line + '\n')
        questions.flush()
    except BrokenPipeError:
        return ''
    return answers.readline()
