"""``taxinet bench chaos``: disturb campaigns at random and check that they recover."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from taxinet_ros.bench.chaos import Chaos, Found, numbers
from taxinet_ros.errors import ExitCode, UsageError

CHAOS = 'chaos'
"""Word given instead of subjects."""

MINUTES = 10.0
_OWN = ('seed', 'trials', 'trial')


def asks_for_chaos(words: Sequence[str], given: Collection[str]) -> bool:
    """Whether the words after ``taxinet bench`` ask for chaos.

    Raises:
        UsageError: other subjects are given too, or the options do not apply.
    """
    chaos = CHAOS in words
    if chaos and len(words) > 1:
        raise UsageError(f'bench: {CHAOS} cannot be combined with other subjects')
    allowed = {*_OWN, 'minutes', 'as_json', 'subjects'}
    wrong = set(given) - allowed if chaos else set(given) & set(_OWN)
    if wrong:
        reason = f'not with {CHAOS}' if chaos else f'only with taxinet bench {CHAOS}'
        raise UsageError(f'bench: --{min(wrong)}: {reason}')
    if len(set(given) & {'minutes', 'trials', 'trial'}) > 1:
        raise UsageError(f'bench: {CHAOS} takes one of --minutes, --trials and --trial')
    return chaos


def run_chaos(
    *, seed: int, minutes: float | None, trials: int | None, trial: int | None, as_json: bool
) -> int:
    """Run the trials and print the results.

    Returns:
        Exit code: 0 no failure, 4 some trial failed.

    Raises:
        UsageError: bad numbers.
        InfraError: an undisturbed campaign fails.
    """
    if minutes is not None and not 0 < minutes < float('inf'):
        raise UsageError(f'bench: --minutes is {minutes:g}, needs to be more than 0')
    if minutes is None and trials is None and trial is None:
        minutes = MINUTES
    console = Console(highlight=False, stderr=as_json)
    folder = Path(tempfile.mkdtemp(prefix='taxinet-chaos-'))
    chaos = Chaos(folder, _taxinet(), seed)
    try:
        for number in numbers(trials, minutes, trial):
            before = len(chaos.found.broken)
            chaos.trial(number)
            for _, kind, words in chaos.found.broken[before:]:
                console.print(f'trial {number}: {kind}: {words}', soft_wrap=True, markup=False)
    finally:
        if not chaos.found.broken:
            shutil.rmtree(folder)
    found = chaos.found
    print(json.dumps(found.report(), indent=2)) if as_json else _print(console, found, folder)
    return ExitCode.INFRA if found.broken else ExitCode.OK


def _taxinet() -> list[str]:
    """The installed command, which blocks signals while Python starts."""
    beside = Path(sys.executable).with_name('taxinet')
    here = [sys.executable, '-P', '-c', 'from taxinet_ros.cli.start import main; main()']
    return [str(beside)] if beside.exists() else here


def _print(console: Console, found: Found, folder: Path) -> None:
    report = found.report()
    console.print(
        f'{found.trials} trials, {found.sittings} commands, {found.rows} rows compared with those '
        'of undisturbed campaigns', soft_wrap=True,
    )
    table = Table(box=None, pad_edge=False)
    for heading in ('fault', 'times', 'ended with'):
        table.add_column(heading, no_wrap=True)
    for name, ends in report['faults'].items():
        words = ', '.join(f'{code}: {times}' for code, times in sorted(ends.items()))
        table.add_row(name, str(sum(ends.values())), words)
    console.print(table)
    if not found.broken:
        console.print('nothing broke')
        return
    words = ', '.join(f'{times} {kind}' for kind, times in report['found'].items())
    first = found.broken[0][0]
    console.print(
        f'broke: {words}; to repeat one: taxinet bench chaos --seed {found.seed} --trial {first}; '
        f'its remains: {folder}', soft_wrap=True,
    )
