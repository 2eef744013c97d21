"""A campaign from the command line: steady-state wall time per run, by number of workers."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

from processes import TAXINET, VERDICTS, Amounts

from taxinet_ros.bench.measure import Subject
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.processes.child import ChildProcess, package_environment
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import is_campaign

WORKERS = (1, 2)
RUNS = 8
"""Runs of each campaign; the first one of each worker is not counted."""

_SEARCH = (
    'falsify', 's_falsif', '--sampler', 'random', '--perception', 'taxinet', '--images', 'none',
    '--quiet',
)
_POLL_S = 0.005
_LIMIT_S = 600.0


def subjects(stack: ExitStack, amounts: Amounts) -> list[Subject]:
    """Runs of a random search with the shipped network, without pictures in the bags.

    Args:
        stack: removes their files.
        amounts: not changed.
    """
    del amounts
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='taxinet-campaign-')))
    return [
        Subject(
            name='campaign', run=partial(_search, folder, workers), warm_ups=0, most=3,
            simulated_s=Scenario().duration_s,
        )
        for workers in WORKERS
    ]


def _search(folder: Path, workers: int) -> Mapping[str, int]:
    out = Path(tempfile.mkdtemp(dir=folder)) / 'out'
    words = [*_SEARCH, '--workers', str(workers), '--runs', str(RUNS), '--out', str(out)]
    with ChildProcess(
        'taxinet falsify', [*TAXINET, *words], log=out.parent / 'printed.txt',
        environment=package_environment(),
    ) as process:
        try:
            stamps = _watch(process, out)
        finally:
            process.end()
        if process.code not in VERDICTS or len(stamps) != RUNS:
            detail = f'{len(stamps)} of {RUNS} runs, {process.how_it_ended()}'
            raise InfraError(InfraKind.DIED, process.name, -1, detail)
    counted = RUNS - workers
    name = f'{workers} worker' if workers == 1 else f'{workers} workers'
    return {name: (stamps[-1] - stamps[workers - 1]) // counted}


def _watch(process: ChildProcess, folder: Path) -> list[int]:
    """Times at which each result was first seen on disk, by :func:`time.perf_counter_ns`."""
    stamps: list[int] = []
    deadline = time.monotonic() + _LIMIT_S
    ended = False
    while not ended:
        ended = process.dead
        if is_campaign(folder):
            with suppress(UsageError):  # just created, nothing in it yet
                results = len(read_campaign(folder).rows)
                stamps += [time.perf_counter_ns()] * (results - len(stamps))
        if time.monotonic() > deadline:
            raise InfraError(
                InfraKind.TIMEOUT, process.name, -1, f'not done after {_LIMIT_S:g} s'
            )
        time.sleep(_POLL_S)
    return stamps
