"""``taxinet bench soak``: watch many runs, or a running process, for resource growth."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from functools import partial

from rich.console import Console
from rich.table import Table

from taxinet_ros.bench.soak import (
    DURATION_S,
    GROWS,
    OBJECTS,
    RUN,
    RUNS,
    WARM_UP,
    Soak,
    Trend,
    soak_runs,
    watch,
)
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import ExitCode, UsageError

SOAK = 'soak'
"""Word given instead of subjects."""

MINUTES_WATCHED = 10.0
_OWN = ('runs', 'duration', 'minutes', 'pid')
_NAMES = {
    'memory': 'resident memory', 'files': 'open files', 'threads': 'threads',
    'segments': 'shared-memory segments', OBJECTS: 'Python objects',
}
_WIDTH = 100


def asks_for_soak(words: Sequence[str], given: Collection[str]) -> bool:
    """Whether the words after ``taxinet bench`` ask for a soak.

    Args:
        words: the subjects.
        given: names of the parameters given on the command line.

    Raises:
        UsageError: other subjects are given too, or the options do not apply.
    """
    soak = SOAK in words
    if soak and len(words) > 1:
        raise UsageError(f'bench: {SOAK} cannot be combined with other subjects')
    wrong = set(given) - {*_OWN, 'as_json', 'subjects'} if soak else set(given) & set(_OWN)
    if wrong:
        reason = f'not with {SOAK}' if soak else f'only with taxinet bench {SOAK}'
        raise UsageError(f'bench: --{min(wrong)}: {reason}')
    return soak


def run_soak(
    *, runs: int | None, duration_s: float | None, minutes: float | None, pid: int | None,
    as_json: bool,
) -> int:
    """Run the soak test and print the results.

    Returns:
        Exit code: 0, 1 if something grows, 130 after an interrupt.

    Raises:
        UsageError: bad numbers, options that do not go together, or no such process.
        InfraError: a run has no verdict.
    """
    _check(runs, minutes, pid, duration_s)
    with stage_bars(Console(stderr=as_json)) as show:
        step = partial(show, 'soaking')
        if pid is not None:
            found = watch(pid, minutes or MINUTES_WATCHED, step)
        else:
            found = soak_runs(runs or RUNS, minutes, step, duration_s or DURATION_S)
    print(json.dumps(found.report(), indent=2)) if as_json else _print(found)
    if found.interrupted:
        return ExitCode.INTERRUPTED
    return ExitCode.VIOLATED if found.verdict == GROWS else ExitCode.OK


def _check(
    runs: int | None, minutes: float | None, pid: int | None, duration_s: float | None
) -> None:
    if pid is not None and (runs is not None or duration_s is not None):
        raise UsageError('bench: --pid watches a running process; leave out --runs and --duration')
    if duration_s is not None:
        Scenario(duration_s=duration_s)  # raises UsageError if invalid
    if minutes is not None and not 0 < minutes < float('inf'):
        raise UsageError(f'bench: --minutes is {minutes:g}, needs to be more than 0')


def _print(found: Soak) -> None:
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    amount = f'{found.amount:.0f}' if found.unit == RUN else f'{found.amount:.0f} s of'
    took = f', {found.wall_s:.0f} s' if found.unit == RUN else ''
    console.print(f'{amount} {found.what}{took}, {found.samples} samples', soft_wrap=True)
    table = Table(box=None, pad_edge=False)
    table.add_column('', no_wrap=True)
    per = 'per 100 runs' if found.unit == RUN else 'per hour'
    for heading in ('first', 'warm', 'last', 'most', per, ''):
        table.add_column(heading, justify='right', no_wrap=True)
    for name, trend in found.trends.items():
        table.add_row(_NAMES[name], *_cells(name, trend, 100 if found.unit == RUN else 3600))
    console.print(table)
    console.print(f'warm: after {WARM_UP:.0%} of it; the slope is from there on', style='dim')
    if found.interrupted:
        console.print('stopped early')
    console.print(f'verdict: {found.verdict}')


def _cells(name: str, trend: Trend, units: int) -> list[str]:
    told = _megabytes if name == 'memory' else _pieces
    levels = [told(value) for value in (trend.first, trend.warm, trend.last, trend.most)]
    slope = trend.slope * units
    return [*levels, f'{slope / 1024:+.1f} kB' if name == 'memory' else f'{slope:+.2f}',
            trend.verdict]  # fmt: skip


def _megabytes(size: float) -> str:
    return f'{size / 2**20:.1f} MB'


def _pieces(count: float) -> str:
    return f'{count:,.0f}'
