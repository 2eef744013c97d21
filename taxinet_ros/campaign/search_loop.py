"""Keeps every worker of a search busy until it ends."""

from __future__ import annotations

from typing import Protocol

from taxinet_ros.campaign.crew import Crew
from taxinet_ros.core.outcome import RunRequest, RunResult

_POLL_S = 0.2


class Asker(Protocol):
    """What decides which run comes next: a search, or the shrinking of a failed run."""

    @property
    def interrupted(self) -> bool:
        """Whether the runs under way are to be ended, and no others begun."""

    def next(self) -> RunRequest | None:
        """A run to begin now; None where there is none before another run has ended, or at all."""

    def take(self, request: RunRequest, result: RunResult) -> None:
        """Take the answer to a run."""


def run_search(search: Asker, crew: Crew) -> None:
    """Run a search to its end, or until it is interrupted and the runs under way have ended.

    Raises:
        UsageError: program or perception failed in a way that the user has to mend.
    """
    while True:
        if search.interrupted and not crew.interrupted:
            crew.interrupt()
        while crew.free and (request := search.next()) is not None:
            crew.give(request)
        if not crew.busy:
            return
        for request, result in crew.answers(_POLL_S):
            search.take(request, result)
