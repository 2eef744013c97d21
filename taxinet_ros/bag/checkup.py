"""Everything that can be checked about a bag."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from taxinet_ros.bag.check_run import (
    RunRecord,
    check_stamps,
    check_steps,
    check_verdict,
    read_record,
    read_records,
)
from taxinet_ros.bag.check_storage import (
    check_bytes,
    check_description,
    check_index,
    check_topics,
)
from taxinet_ros.bag.errors import BagEmpty, BagError
from taxinet_ros.bag.findings import Check, Finding
from taxinet_ros.bag.reader import BagInfo, read_info
from taxinet_ros.bag.runs import read_recording


@dataclass(frozen=True, kw_only=True)
class Checkup:
    """A bag and all answers.

    Attributes:
        info: its table of contents.
        checks: in the order in which they were made.
    """

    info: BagInfo
    checks: tuple[Check, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All that is wrong."""
        return tuple(finding for check in self.checks for finding in check.findings)


def check_bag(path: Path) -> Checkup:
    """Check a bag; it is only read.

    Raises:
        BagEmpty: not one message of it can be read, and it is not whole either.
        BagForeign, UsageError: as ``reader.read_messages``.
    """
    damage: list[BagError] = []
    info = read_info(path, damage.append)
    if damage and not any(info.counts.values()):
        raise BagEmpty(str(damage[0]), path=path)
    return Checkup(
        info=info,
        checks=(
            check_bytes(info, damage),
            check_index(path, sound=not damage),
            check_description(info),
            check_topics(info),
            *_run_checks(path, info),
        ),
    )


def _run_checks(path: Path, info: BagInfo) -> Iterator[Check]:
    recording = read_recording(path)
    if recording.plain or not recording.runs:
        yield from _checks_of(read_record(path), [topic.name for topic in info.topics], '')
        return
    yield Check(
        name='messages', looked_at='every message is what its topic says',
        findings=tuple(Finding(where=path.name, what=str(error)) for error in recording.broken),
    )
    # What the topics of others hold, and that some hold nothing, is their affair.
    for run, record in zip(recording.runs, read_records(recording), strict=True):
        if not run.absent:
            yield from _checks_of(record, list(record.counts), f'{run.name}: ')


def _checks_of(record: RunRecord, topics: Sequence[str], of: str) -> Iterator[Check]:
    for check in (check_stamps(record), check_steps(record, topics), check_verdict(record)):
        yield replace(check, looked_at=f'{of}{check.looked_at}')
