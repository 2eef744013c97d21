"""Everything that can be checked about a bag."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.bag.check_run import check_stamps, check_steps, check_verdict, read_record
from taxinet_ros.bag.check_storage import (
    check_bytes,
    check_description,
    check_index,
    check_topics,
)
from taxinet_ros.bag.errors import BagEmpty, BagError
from taxinet_ros.bag.findings import Check, Finding
from taxinet_ros.bag.reader import BagInfo, read_info


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
    record = read_record(path)
    return Checkup(
        info=info,
        checks=(
            check_bytes(info, damage),
            check_index(path, sound=not damage),
            check_description(info),
            check_topics(info),
            check_stamps(record),
            check_steps(record, info),
            check_verdict(record),
        ),
    )
