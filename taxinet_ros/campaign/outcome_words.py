"""Outcomes counted in words; those of a bench that broke, by how it did."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.outcome import Outcome


def count_outcomes(rows: Sequence[RunRow], leaving_out: Iterable[Outcome] = ()) -> str:
    """How many runs ended how, e.g. ``4 PASS, 3 INFRA_ERROR (2 timeout, 1 died)``."""
    wanted = [outcome for outcome in Outcome if outcome not in set(leaving_out)]
    counts = {outcome.value: sum(row.outcome is outcome for row in rows) for outcome in wanted}
    return count_words(counts, count_kinds(row.kind for row in rows if row.kind))


def count_kinds(kinds: Iterable[str]) -> dict[str, int]:
    """How many runs the bench broke in which way, the most frequent first."""
    return dict(sorted(Counter(kinds).items(), key=lambda kind: (-kind[1], kind[0])))


def count_words(counts: Mapping[str, int], kinds: Mapping[str, int]) -> str:
    """Counts by outcome in words, those that are none left out.

    Args:
        counts: by outcome, in the order in which they are named.
        kinds: how many runs the bench broke in which way.
    """
    how = f' ({kind_words(kinds)})' if kinds else ''
    return ', '.join(
        f'{number:,} {name}{how if name == Outcome.INFRA_ERROR else ""}'
        for name, number in counts.items() if number
    )


def kind_words(kinds: Mapping[str, int]) -> str:
    """How often the bench broke in which way, in words."""
    return ', '.join(f'{number:,} {kind}' for kind, number in kinds.items())
