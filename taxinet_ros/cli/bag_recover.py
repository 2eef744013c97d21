"""``taxinet bag recover``: what is sound of a bag into a new one."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.bag.check_run import PERIOD_NS, read_record, whole_steps
from taxinet_ros.bag.facts import read_facts
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.recover import Recovery, recover
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
    print(f'saved {recovery.saved} messages{_steps(out)} into {out}')
    lost = _lost(recovery)
    if lost:
        print(lost)
    return LOSSY if lost else WHOLE


def _steps(bag: Path) -> str:
    """How much of the run the new bag holds; empty where it is no run of ours."""
    facts = read_facts(bag)
    if facts is None:
        return ''
    topics = [topic.name for topic in read_info(bag).topics]
    whole = whole_steps(read_record(bag), topics)
    planned = round(facts.scene['duration'] * NS_PER_S) // PERIOD_NS + 1
    ended = f', ended as {facts.outcome}' if facts.outcome else ''
    return f', {whole} whole control steps of {planned} planned{ended},'


def _lost(recovery: Recovery) -> str:
    """One line on what is lost; empty if nothing."""
    if recovery.declared is not None and recovery.declared != recovery.saved:
        return f'lost {recovery.declared - recovery.saved} of {recovery.declared} messages'
    if recovery.damage and recovery.declared is None:
        return 'lost what was being written when the recording ended; how much, nothing tells'
    return 'lost no message, but what stands above' if recovery.damage else ''
