"""Results of bag checks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

RECOVER = 'taxinet bag recover {bag} --out NEW'
"""Command that copies intact messages to a new bag; the bag's path is filled in."""
RERUN = 'taxinet run --from {bag}'
"""Command that runs the recorded scene again; the bag's path is filled in."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One problem.

    Attributes:
        where: byte, step, topic or file.
        what: one-line description.
        fix: repair command, with ``{bag}`` for the bag's path; '' if there is none.
    """

    where: str
    what: str
    fix: str = ''


@dataclass(frozen=True, kw_only=True)
class Check:
    """One check of a bag and its result.

    Attributes:
        name: one word.
        looked_at: what was checked, in one line; if ``skipped``, why not.
        findings: problems found.
        skipped: the check is not applicable or not possible.
    """

    name: str
    looked_at: str
    findings: tuple[Finding, ...] = ()
    skipped: bool = False


def ranges(numbers: Iterable[int]) -> str:
    """Short text of integers, e.g. ``3, 7-9``; shows only the first ranges."""
    parts: list[tuple[int, int]] = []
    for number in sorted(set(numbers)):
        if parts and parts[-1][1] == number - 1:
            parts[-1] = (parts[-1][0], number)
        else:
            parts.append((number, number))
    return _joined([f'{a}' if a == b else f'{a}-{b}' for a, b in parts])


def _joined(words: Sequence[str], most: int = 6) -> str:
    more = f' and {len(words) - most} more' if len(words) > most else ''
    return ', '.join(words[:most]) + more


def conclusion(fixes: Sequence[str]) -> str:
    """The commands that fix some findings, '' for what none fixes; '' without findings."""
    counts = Counter(fixes)
    lost = counts.pop('', 0)
    parts = [f'{number} fixed by: {command}' for command, number in counts.items()]
    if lost:
        parts.append(f'{lost} only by making it again')
    return f'{len(fixes)} found; {"; ".join(parts)}' if fixes else ''
