"""Shards: parts of a search that run apart from each other, each a campaign of its own.

Shard ``i/n`` has the runs i-1, i-1+n, i-1+2n and so on of the search, with the very numbers, names
and scenes that they have in the whole. So a shard is a fair sample of it, and a search of more runs
(``--resume --runs``) has the same shards, each with more runs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from taxinet_ros.errors import UsageError

SHARD = 'shard'
"""The fact that names the part of a search that a campaign is; absent if it is the whole."""
EXHAUSTED = 'exhausted_at'
"""The fact, of a shard, that the sampler had so many points for the whole search, and no more."""
MERGED = 'merged'
"""The fact, of a merged campaign, that lists its shards."""


@dataclass(frozen=True, slots=True)
class Shard:
    """One part of a search.

    Attributes:
        number: number of the part, from 1.
        count: number of parts.
    """

    number: int
    count: int

    def __str__(self) -> str:
        return f'{self.number}/{self.count}'

    def __contains__(self, index: int) -> bool:
        return index % self.count == self.number - 1

    def runs(self, total: int) -> range:
        """Indices of its runs in a search of ``total`` runs."""
        return range(self.number - 1, total, self.count)


def parse_shard(text: str) -> Shard:
    """Parse ``i/n``.

    Raises:
        UsageError: it has another form, or is none of 1/n to n/n.
    """
    found = re.fullmatch(r'([0-9]{1,9})/([0-9]{1,9})', text.strip())
    shard = Shard(*map(int, found.groups())) if found else Shard(0, 0)
    if not 1 <= shard.number <= shard.count:
        raise UsageError(f'--shard {text}: expected I/N, one of 1/N to N/N')
    return shard


def recorded_shard(facts: Mapping[str, Any]) -> Shard | None:
    """The part of a search that a recorded campaign is; None if it is no shard."""
    return parse_shard(str(facts[SHARD])) if facts.get(SHARD) else None


def planned_runs(facts: Mapping[str, Any]) -> range | None:
    """Indices of the runs planned before the first one; None if not recorded."""
    planned = facts.get('first_runs', facts.get('runs'))
    if planned is None:
        return None
    return (recorded_shard(facts) or Shard(1, 1)).runs(int(planned))
