"""``taxinet bench processors``: digests of fixed runs, to compare machines to the bit."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from taxinet_ros.bench.processors import (
    DURATION_S,
    SCENES,
    differing_runs,
    load_digests,
    measure_processors,
)
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.provenance import known, words
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.instructions import lacking

PROCESSORS = 'processors'
"""Word given instead of subjects."""
_OWN = {'runs', 'duration', 'compare', 'as_json', 'subjects'}


def asks_for_processors(subjects: Sequence[str], given: Collection[str]) -> bool:
    """Whether the words after ``taxinet bench`` ask for the digests.

    Raises:
        UsageError: other subjects are given too, or options that do not apply.
    """
    if PROCESSORS not in subjects:
        return False
    if len(subjects) > 1:
        raise UsageError(f'bench: {PROCESSORS} cannot be combined with other subjects')
    wrong = set(given) - _OWN
    if wrong:
        raise UsageError(f'bench: --{min(wrong)}: not with {PROCESSORS}')
    return True


def run_processors(
    *, scenes: int | None, duration_s: float | None, old: Path | None, as_json: bool
) -> int:
    """Run the scenes, print their digests, and compare them with an earlier report.

    Args:
        scenes: number of scenes, each with two networks; as in the earlier report if None.
        duration_s: length of the runs [s]; the same.
        old: report of another machine.
        as_json: print JSON.

    Returns:
        Exit code: 1 if runs differ from the earlier report, else 0.

    Raises:
        UsageError: bad numbers, or a report that is none or of other runs.
    """
    before = None if old is None else load_digests(old)
    if before is not None:
        asked = (scenes or before['scenes'], duration_s or before['duration_s'])
        if asked != (before['scenes'], before['duration_s']):
            raise UsageError(
                f'bench: {old} has {before["scenes"]} scenes of {before["duration_s"]:g} s; leave '
                'out --runs and --duration to repeat these'
            )
        scenes, duration_s = asked
    with stage_bars(Console(stderr=as_json)) as show:
        report = measure_processors(
            scenes or SCENES, DURATION_S if duration_s is None else duration_s,
            lambda done, total: show('running', done, total),
        )
    differing = [] if before is None else differing_runs(report['runs'], before['runs'])
    if as_json:
        compared = {} if before is None else {'differing': differing}
        print(json.dumps({**report, **compared}, indent=2))
    else:
        _print(report, before, differing)
    return ExitCode.VIOLATED if differing else ExitCode.OK


def _print(
    report: dict[str, Any], before: dict[str, Any] | None, differing: Sequence[str]
) -> None:
    runs = len(report['runs'])
    print(words(known(report['machine'])))
    if lacking():
        print(f'this processor lacks {lacking()}: its libraries may round differently')
    print(f'{runs} runs of {report["duration_s"]:g} s, frames and bags: digest {report["digest"]}')
    if before is None:
        print(f'compare: taxinet bench {PROCESSORS} --json > HERE.json; elsewhere, '
              f'taxinet bench {PROCESSORS} --compare HERE.json')
        return
    for line in differing:
        print(f'differs: {line}')
    print(f'{runs - len(differing)} of {runs} runs equal those of the other machine to the bit')
