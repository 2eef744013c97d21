"""The engine of campaigns: what proposes runs on one side, what makes them on the other."""

from __future__ import annotations

from typing import Protocol

from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
from taxinet_ros.trials.worker_pool import Answer

_POLL_S = 0.2


class RunSource(Protocol):
    """Source of the next run: a search, or the shrinking of a failed run."""

    @property
    def interrupted(self) -> bool:
        """Whether to end the runs in flight and start no others."""

    def next(self) -> RunRequest | None:
        """The next run to start; None if none is ready or there are no more."""

    def take(self, request: RunRequest, result: RunResult) -> None:
        """Record the result of a run."""


class Executor(Protocol):
    """What makes the runs: a pool of worker processes here, or of a cluster."""

    interrupted: bool

    @property
    def busy(self) -> int:
        """Number of runs in flight."""

    @property
    def free(self) -> bool:
        """Whether one more run can be started."""

    def give(self, request: RunRequest) -> None:
        """Start a run."""

    def answers(self, timeout_s: float) -> list[Answer]:
        """The runs finished since the last call; waits for one, at most ``timeout_s``."""

    def interrupt(self) -> None:
        """Request an orderly end of all runs in flight; no more may be started."""


def run_search(search: RunSource, pool: Executor) -> None:
    """Run a search to its end, or until it is interrupted and the runs in flight have ended.

    Raises:
        UsageError: program or perception failed with an error that the user must fix.
    """
    while True:
        if search.interrupted and not pool.interrupted:
            pool.interrupt()
        while pool.free and (request := search.next()) is not None:
            pool.give(request)
        if not pool.busy:
            return
        for request, result in pool.answers(_POLL_S):
            search.take(request, result)
