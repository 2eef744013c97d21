"""Robustness monitors: ours, online and offline, and third-party ones in another environment."""

from __future__ import annotations

import json
import math
import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from taxinet_ros.bench.measure import Subject
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, max_gap_ns, signals
from taxinet_ros.core.mtl import Monitor, Spec, parse_spec, robustness, signal_names
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError
from taxinet_ros.core.verdict.run_statistics import EstimateWatch
from taxinet_ros.errors import UsageError
from taxinet_ros.processes.child import ChildProcess

LAST = 300
LENGTHS = {'1k': 1_000, '10k': 10_000, '100k': 100_000}
"""Number of samples of the longer runs, by the word that names them."""
WINDOWS_S = (10, 100, 1_000)
_GROWING = ('phi_always', 'phi_eventually')
_NESTED = {
    'G F': 'always(eventually[0:5](cte < 0))',
    'G or F': 'always(cte < 1 or eventually[0:5](cte < 0))',
    'F G F': 'eventually[0:5](always(eventually[0:2](cte < 0)))',
    '12 until': '(' * 12 + 'cte < 0' + ') until[0:0.5] (cte < 1)' * 12,
}
"""Formulas with nested windows, by the word that names them."""
_OFFLINE_CALLS = 20
Run = Sequence[tuple[int, dict[str, float]]]


def subjects() -> list[Subject]:
    """One sample and all samples of a 30 s run; samples of longer runs and wider windows."""
    run = swinging_run(LAST)
    found: list[Subject] = []
    for name, spec in SHIPPED.items():
        found += [_online(f'{name} sample', spec, run), _offline(f'{name} offline', spec, run)]
    for word, last in LENGTHS.items():
        longer = swinging_run(last)
        for name in _GROWING:
            found.append(_online(f'{name} sample of {word}', SHIPPED[name], longer))
    for word, last in LENGTHS.items():
        longer = swinging_run(last)
        for name in _GROWING:
            found.append(_offline(f'{name} offline of {word}', SHIPPED[name], longer))
    longer = swinging_run(LENGTHS['10k'])
    for window_s in WINDOWS_S:
        text = f'eventually[0:{window_s}](always(abs(cte) <= 1.5))'
        found.append(_online(f'window of {window_s} s sample of 10k', parse_spec(text), longer))
    for word in ('1k', '10k'):
        longer = swinging_run(LENGTHS[word])
        for name, text in _NESTED.items():
            found.append(_online(f'{name} sample of {word}', parse_spec(text), longer))
    return found


def swinging_run(last: int) -> Run:
    """True states that oscillate towards the centreline, with stamps [ns]; ``last + 1`` samples."""
    return [(step * CONTROL_PERIOD_NS, _sample(step)) for step in range(last + 1)]


def _sample(step: int) -> dict[str, float]:
    cte_m = 6.0 * math.exp(-step / 40) * math.cos(step / 15)
    return {
        **signals(
            cte_m=cte_m, he_rad=0.0, x_m=400.0 + 0.5 * step, speed_mps=5.0,
            estimate=TrackingError(cte_m=cte_m, he_rad=0.0),
            command=TaxiCommand(steering_rad=0.0, speed_mps=5.0),
        ),
        **dict.fromkeys(EstimateWatch.NAMES, 0.0),
    }


def _online(name: str, spec: Spec, run: Run) -> Subject:
    def follow() -> None:
        monitor = Monitor(spec, run[-1][0], max_gap_ns=max_gap_ns(CONTROL_PERIOD_NS))
        for stamp_ns, sample in run:
            monitor.push(stamp_ns, sample)

    long = len(run) > LENGTHS['1k'] + 1
    return Subject(
        name=f'monitor/{name}',
        run=follow,
        calls=len(run),
        warm_ups=0 if long else 2,
        most=3 if long else None,
    )


def _offline(name: str, spec: Spec, run: Run) -> Subject:
    stamps_ns = [stamp_ns for stamp_ns, _ in run]
    names = signal_names(spec.formula)
    columns = {name: [sample[name] for _, sample in run] for name in names}
    calls = _OFFLINE_CALLS if len(run) <= LENGTHS['1k'] + 1 else 1

    def evaluate() -> None:
        for _ in range(calls):
            robustness(spec.formula, stamps_ns, columns)

    return Subject(name=f'monitor/{name}', run=evaluate, calls=calls, most=20)


_CHILD = Path(__file__).with_name('peers_child.py')
_FORMULAS = {'phi_always': 'G near', 'phi_eventually': 'F[0, 10] G near'}
_SLOW = 'py-mtl'
"""metric-temporal-logic, which takes a second or more."""


@contextmanager
def peer_subjects(python: str) -> Iterator[list[Subject]]:
    """Subjects of the monitors in another Python, which runs until the context is left.

    Args:
        python: its executable, in an environment made from ``tests/core/mtl/oracles.txt``.

    Raises:
        UsageError: there is no such Python, or it has none of the monitors.
    """
    try:
        child = ChildProcess(
            'peers', [python, str(_CHILD)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            environment=os.environ,
        )
    except OSError as error:
        raise UsageError(f'--peers: cannot run {python}: {error.strerror}') from None
    with child:
        answer = _ask(child, _trace_json())
        names = json.loads(answer) if answer else []
        if not names:
            raise UsageError(
                f'--peers: {python} has no rtamt, sentil or metric-temporal-logic; '
                'tests/core/mtl/oracles.txt says how to install them'
            )
        yield [_peer_subject(name, child) for name in names]


def _trace_json() -> str:
    run = swinging_run(LAST)
    return json.dumps(
        {
            'times_s': [stamp_ns / NS_PER_S for stamp_ns, _ in run],
            'cte_m': [sample['cte'] for _, sample in run],
            'formulas': {name: [SHIPPED[name].text, text] for name, text in _FORMULAS.items()},
        }
    )


def _peer_subject(name: str, child: ChildProcess) -> Subject:
    # The other process measures its own time, so communication with it does not count.
    run = partial(_measure_peer, name, child)
    slow = name.startswith(_SLOW)
    return Subject(name='monitor', run=run, warm_ups=0 if slow else 2, most=3 if slow else None)


def _measure_peer(name: str, child: ChildProcess) -> dict[str, int]:
    answer = _ask(child, name)
    if not answer:
        raise UsageError(f'--peers: {name} broke down; its Python says why above')
    return {name: int(answer)}


def _ask(child: ChildProcess, line: str) -> bytes:
    """The answer to a line; empty if the process has ended."""
    questions, answers = child.process.stdin, child.process.stdout
    assert questions is not None, 'a pipe was asked for'
    assert answers is not None, 'a pipe was asked for'
    try:
        questions.write(line.encode() + b'\n')
        questions.flush()
    except BrokenPipeError:
        return b''
    return answers.readline()
