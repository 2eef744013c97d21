"""``taxinet bag recover``: what is sound of a bag into a new one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from taxinet_ros.bag.check_run import PERIOD_NS, read_record, read_records, whole_steps
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.facts import read_all_facts, read_facts
from taxinet_ros.bag.reader import unchecked_files
from taxinet_ros.bag.recover import Recovery, recover
from taxinet_ros.bag.runs import read_recording
from taxinet_ros.cli.bag_errors import LOSSY, WHOLE, exit_code_of
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.types import NS_PER_S


def run_recover(bag: Path, out: Path) -> int:
    """Save what is sound and print what was saved and what is lost.

    Returns:
        Exit code: 0 everything was saved, 3 something is lost, 2 nothing could be saved, 4 the new
        bag does not fit on the disk.

    Raises:
        UsageError: there is nothing at ``bag``, or something at ``out``.
    """
    if bag.is_dir() and out.resolve().is_relative_to(bag.resolve()):
        raise UsageError(f'--out {out}: lies within the bag {bag}, which is left as it is')
    return exit_code_of(bag, lambda: _run(bag, out))


def _run(bag: Path, out: Path) -> int:
    recovery = recover(bag, out)
    for line in recovery.damage:
        print(f'damage: {line}')
    if bare := unchecked_files(bag):
        print(bare)
    try:
        steps = list(_steps(out))
    except BagError:  # What is saved need not be sound as a run.
        steps = []
    one = f', {steps[0]},' if len(steps) == 1 else ''
    print(f'saved {recovery.saved} messages{one} into {out}')
    for line in steps[1:] and steps:
        print(line)
    lost = _lost(recovery)
    if lost:
        print(lost)
    return LOSSY if lost else WHOLE


def _steps(bag: Path) -> Iterator[str]:
    """How much the new bag holds of each run; nothing where it holds none of ours."""
    recording = read_recording(bag)
    if recording.plain:
        told = [('', read_facts(bag), read_record(bag))]
    else:
        facts = read_all_facts(recording)
        told = [
            (f'{run.name}: ', facts[run.name], record)
            for run, record in zip(recording.runs, read_records(recording), strict=True)
            if not run.absent
        ]
    for name, fact, record in told:
        if fact is not None:
            whole = whole_steps(record, list(record.counts))
            planned = round(fact.scene['duration'] * NS_PER_S) // PERIOD_NS + 1
            ended = f', ended as {fact.outcome}' if fact.outcome else ''
            yield f'{name}{whole} whole control steps of {planned} planned{ended}'


def _lost(recovery: Recovery) -> str:
    """One line on what is lost; empty if nothing."""
    if recovery.declared is not None and recovery.declared < recovery.saved:
        return f'saved more messages than the {recovery.declared} that it says it holds'
    if recovery.declared is not None and recovery.declared > recovery.saved:
        return f'lost {recovery.declared - recovery.saved} of {recovery.declared} messages'
    if recovery.damage and recovery.declared is None:
        return 'lost what was being written when the recording ended; how much, nothing tells'
    return 'lost no message, but what stands above' if recovery.damage else ''
