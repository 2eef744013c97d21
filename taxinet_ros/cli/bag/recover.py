"""``taxinet bag recover``: what is whole of a damaged or unfinished bag, as a new one."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import BagArgument
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.rewrite.recovery import Recovery


def recover(
    bag: BagArgument,
    out: Annotated[
        Path, typer.Option(metavar='NEW', help='folder for the new bag; must not exist')
    ],
) -> int:
    """Copy all messages up to the first damage, or to the end of an unfinished bag, to a new one.

    The original bag is never modified. mcap recover, a tool of MCAP, also looks behind the damage.
    """
    from taxinet_ros.cli.bag.input import exit_code_of

    if bag.is_dir() and out.resolve().is_relative_to(bag.resolve()):
        raise UsageError(f'--out {out}: is inside the bag {bag}, which is not modified')
    return exit_code_of(bag, lambda: _recover(bag, out))


def _recover(bag: Path, out: Path) -> int:
    from taxinet_ros.bag.errors import BagError
    from taxinet_ros.bag.rewrite.recovery import recover

    recovery = recover(bag, out)
    for line in recovery.damage:
        print(f'damage: {line}')
    if recovery.unchecked:
        print(recovery.unchecked)
    try:
        steps = list(_steps(out))
    except BagError:  # The recovered bag may still not be a valid run.
        steps = []
    one = f', {steps[0]},' if len(steps) == 1 else ''
    print(f'saved {recovery.saved} messages{one} into {out}')
    for line in steps[1:] and steps:
        print(line)
    lost = _lost(recovery)
    if lost:
        print(lost)
    for file in recovery.damaged_files:
        print(
            'the tool of MCAP also looks for messages behind the damage: '
            f'mcap recover {shlex.quote(str(file))} -o NEW.mcap'
        )
    return ExitCode.INCOMPLETE if lost else ExitCode.OK


def _steps(bag: Path) -> Iterator[str]:
    """Lines on how much of each run the new bag holds."""
    from taxinet_ros.bag.check.lockstep import checked_runs
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.core.types import NS_PER_S

    for name, recording, record in checked_runs(open_recording(bag)):
        fact = recording.facts
        if fact is not None:
            planned = round(fact.scene['duration_s'] * NS_PER_S) // recording.period_ns + 1
            ended = f', ended as {fact.outcome}' if fact.outcome else ''
            of = f'{name}: ' if name else ''
            yield f'{of}{record.whole_steps()} whole control steps of {planned} planned{ended}'


def _lost(recovery: Recovery) -> str:
    """One line on what is lost; empty if nothing."""
    if recovery.declared is not None and recovery.declared < recovery.saved:
        return f'saved more messages than the {recovery.declared} declared'
    if recovery.declared is not None and recovery.declared > recovery.saved:
        return f'lost {recovery.declared - recovery.saved} of {recovery.declared} messages'
    if recovery.damage and recovery.declared is None:
        return 'lost an unknown amount of data being written when the recording ended'
    return 'lost no message except as stated above' if recovery.damage else ''
