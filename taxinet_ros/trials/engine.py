"""The engine of campaigns: it makes and records the runs that a proposer asks for.

Proposers are the program in its own order (:mod:`.campaign`), a sampler (:mod:`.search`) and the
shrinking of a failed run (:mod:`.shrink`). The engine does what is common to all: it keeps the
record, retries broken runs, ends when the bench stays broken or on an interrupt, and goes on later.
Runs may be concurrent and end in any order. To resume, what is recorded is given to the proposer
when it asks for it, and what is missing is run; so the table equals that of a campaign that was
never interrupted.
"""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import itertools
from bisect import insort
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from taxinet_ros.bag.writer import MIN_FREE_BYTES, check_room
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.user_code import EXTERNAL
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.samplers.sampler import LAG, Exhausted
from taxinet_ros.scenes.source import Rejected
from taxinet_ros.trials.options import AUDIT, CampaignOptions
from taxinet_ros.trials.record.book import CampaignBook, finished_row, rejected_row
from taxinet_ros.trials.record.content import CampaignContent, StoredRows
from taxinet_ros.trials.record.facts import planned_runs
from taxinet_ros.trials.record.resumption import check_same_campaign, kept_facts, undecided_facts
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import Summary
from taxinet_ros.trials.worker_pool import Answer


class Proposer(abc.ABC):
    """What chooses the scenes of a campaign.

    Attributes:
        campaign: options of the campaign.
        source: what it needs, entered before the record is opened.
        runs: number of runs that complete it; None if only the proposer knows.
        patience: number of consecutive infrastructure errors that end it.
        retries: whether a run is tried again, once, after an infrastructure error.
    """

    campaign: CampaignOptions
    source: AbstractContextManager[Any]
    runs: int | None
    patience: int
    retries = True

    @abc.abstractmethod
    def prepare(self) -> dict[str, Any]:
        """Get ready to propose, within the ``source``.

        Returns:
            All that the runs depend on, as facts for the record.

        Raises:
            UsageError: it cannot propose scenes of this campaign.
        """

    def resume(self, content: CampaignContent) -> tuple[Mapping[int, RunRow], Mapping[str, Any]]:
        """Take what the record contains, before the first proposal.

        Returns:
            The rows, by index, of runs that are not made again, and further facts.
        """
        return {}, {}

    def stop_reason(self) -> str:
        """Why no more runs are needed although some are left, by the rows taken; or ''."""
        return ''

    @abc.abstractmethod
    def propose(self) -> int | None:
        """The number of the next run; None while it depends on results that are missing.

        Raises:
            Exhausted: there are no more.
        """

    @abc.abstractmethod
    def scene(self, index: int) -> Scenario:
        """The scene of the run just proposed.

        Raises:
            Rejected: there is none; this is the result of the run.
        """

    def replay(self, row: RunRow) -> None:  # noqa: B027 (nothing to do for most)
        """Follow how the scene of the run just proposed was chosen in an earlier session."""

    @abc.abstractmethod
    def completed(self, row: RunRow) -> RunRow:
        """A new row with how its scene was chosen, and how often it was retried earlier."""

    def take(self, row: RunRow) -> None:  # noqa: B027 (not all of them learn)
        """Learn from a row, new or of an earlier session."""

    def hear(self, facts: Mapping[str, Any], result: RunResult) -> Mapping[str, Any]:
        """Facts that a result adds to those of the campaign.

        Raises:
            UsageError: it is from another graph than earlier results.
        """
        return {}


P_co = TypeVar('P_co', bound=Proposer, covariant=True)


class Engine(Generic[P_co]):
    """The engine of one campaign; a context manager.

    Attributes:
        proposer: what chooses the scenes.
        options: options of the campaign.
        rows: one row per completed run, also of earlier sessions, in the order in which they were
            needed or ended; after the ``with``, also rows that were not needed in this session.
        summary: what is known of all of them, without reading them.
        stopped: why it ended early, or ''.
        exhausted: whether the proposer had no more scenes.
        broken: the row of the infrastructure error that ended it, or None.
        interrupted: whether :meth:`interrupt` was called, or a run ended so.
        book: the campaign on disk.
    """

    def __init__(
        self, proposer: P_co, participants: Sequence[str],
        on_row: Callable[[RunRow], None] = lambda row: None,
    ) -> None:
        """Create it; nothing is started or written before the ``with``.

        Args:
            proposer: what chooses the scenes, not yet prepared.
            participants: names of the nodes in every run.
            on_row: called with each new row once it is on disk; not with earlier ones.
        """
        self.proposer = proposer
        self.options = proposer.campaign
        self.rows = StoredRows(self.options.out / RECORD_NAME, (), {})
        self.summary = Summary()
        self.stopped = ''
        self.exhausted = False
        self.broken: RunRow | None = None
        self.interrupted = False
        self.book = CampaignBook(self.options, participants, on_row, resume=self.options.resume)
        self._recorded: Mapping[int, RunRow] = {}
        self._asked = 0
        self._retries: list[RunRequest] = []
        self._retried: set[int] = set()
        self._started: dict[int, int] = {}  # in flight, with their place in the order of start
        self._places = itertools.count()
        self._broken: list[int] = []  # places of broken ones

    def __enter__(self) -> Self:
        """Prepare the proposer, then open the folder.

        Raises:
            UsageError: the proposer cannot be used, or the folder, or this contains another
                campaign.
        """
        self.book.check_folder()
        if self.options.bag_folder is not None and not self.options.standing_graph:
            above = self.options.out.absolute()
            check_room(next(one for one in (above, *above.parents) if one.is_dir()), MIN_FREE_BYTES)
        with contextlib.ExitStack() as opened:
            opened.enter_context(self.proposer.source)
            facts = self.proposer.prepare()
            opened.enter_context(self.book)
            earlier = self.book.earlier
            check_same_campaign(self.options.out, earlier, facts, undecided_facts(facts))
            self._recorded, more = self.proposer.resume(earlier)
            self.book.begin({**facts, **kept_facts(earlier.facts, facts), **more})
            self._opened = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of the rows so far, even after an error."""
        earlier = self.book.earlier.by_index
        for index in sorted(earlier.keys() - self.summary.indices):
            if earlier[index].outcome is not Outcome.INTERRUPTED:
                self._count(earlier[index])
        runs = self.proposer.runs
        self.book.complete = (runs is not None and len(self.rows) >= runs) or bool(
            self.stopped and not self.interrupted and self.broken is None
        )
        self._opened.__exit__(kind, error, trace)

    @property
    def perception(self) -> str:
        """Name of the perception; '' before a standing graph has answered."""
        return str(self.book.facts['perception'])

    @property
    def first_planned(self) -> range | None:
        """Indices of the runs planned before the first one; only within the ``with``."""
        return planned_runs(self.book.facts)

    @property
    def ended(self) -> bool:
        """Whether no more runs will be requested."""
        runs = self.proposer.runs
        return self.interrupted or (not self._retries and (
            bool(self.stopped) or (runs is not None and self._asked >= runs)
        ))

    def interrupt(self) -> None:
        """Request no more runs or retries; safe to call from a signal handler."""
        self.interrupted = True

    def next(self) -> RunRequest | None:
        """The next run to start; None if none is ready or the campaign has ended.

        Raises:
            UsageError: the proposer failed.
        """
        if self._retries and not self.interrupted:
            return self._retries.pop()
        try:
            while self._wants_more() and (index := self.proposer.propose()) is not None:
                request = self._begin(index)
                self._asked = max(self._asked, index + 1)
                if request is not None:
                    return request
        except Exhausted as error:
            self.stopped, self.exhausted = str(error), True
        return None

    def take(self, request: RunRequest, result: RunResult) -> bool:
        """Record one result, or retry the run.

        Returns:
            Whether the graph that made it can make more.

        Raises:
            UsageError: it is from another graph than earlier results; it is not recorded.
        """
        if news := self.proposer.hear(self.book.facts, result):
            self.book.add_facts(news)
        if self._is_retried(request, result):
            self._retried.add(request.index)
            self._retries.append(self.book.begin_run(request.index, request.scenario))
        else:
            self._keep(finished_row(self.options, request, result))
        if result.outcome is Outcome.INTERRUPTED:
            self.interrupt()
        return result.outcome is not Outcome.INFRA_ERROR and not self.interrupted

    def _wants_more(self) -> bool:
        """Whether one more run is needed; runs started earlier are always finished first."""
        runs = self.proposer.runs
        if self.stopped or self.interrupted or (runs is not None and self._asked >= runs):
            return False
        self.stopped = self.proposer.stop_reason()
        return not self.stopped

    def _begin(self, index: int) -> RunRequest | None:
        """The run just proposed; None if it has a row already, or its scene is rejected."""
        if (row := self._recorded.get(index)) is not None:
            self.proposer.replay(row)
            self._count(row)
            self.proposer.take(row)
            return None
        try:
            scenario = self.proposer.scene(index)
        except Rejected as error:
            self._keep(rejected_row(self.options, index, str(error)))
            return None
        self._started[index] = next(self._places)
        return self.book.begin_run(index, scenario)

    def _is_retried(self, request: RunRequest, result: RunResult) -> bool:
        return (
            result.outcome is Outcome.INFRA_ERROR and result.kind != AUDIT
            and request.index not in self._retried and self.proposer.retries
        )

    def _keep(self, row: RunRow) -> None:
        row = self.proposer.completed(row)
        row = dataclasses.replace(row, retries=row.retries + (row.index in self._retried))
        self._count(row)
        self.proposer.take(row)
        place = self._started.pop(row.index, -1)
        if row.outcome not in (Outcome.REJECTED, Outcome.INTERRUPTED):  # the bench was involved
            self._watch_bench(row, place)
        self.book.keep(row)

    def _count(self, row: RunRow) -> None:
        self.rows.append(row)
        self.summary.take(row)

    def _watch_bench(self, row: RunRow, place: int) -> None:
        """End the campaign if its bench is broken, or gives other runs than the graph."""
        if row.outcome is Outcome.INFRA_ERROR:
            # By start, not by end, so that it does not depend on the number of workers.
            insort(self._broken, place)
            streaks = itertools.groupby(enumerate(self._broken), lambda each: each[1] - each[0])
            in_a_row = max(len(list(streak)) for _, streak in streaks)
            if in_a_row >= self.proposer.patience:
                self.stopped = f'{in_a_row} runs in a row were broken by the bench'
                self.broken = row
        if row.kind == AUDIT:
            self.stopped, self.broken = f'audit of run {row.index}: {row.detail}', row


def with_workers(
    campaign: CampaignOptions, workers: int, cluster: str | None, lag: int = LAG
) -> CampaignOptions:
    """The campaign with what makes its runs: worker processes here, or a cluster.

    Args:
        campaign: the campaign.
        workers: number of worker processes.
        cluster: a Dask cluster as for :func:`.pool.check_cluster`, or None.
        lag: number of runs that may be in flight.

    Raises:
        UsageError: too many workers, no cluster, or runs that a cluster cannot make.
    """
    if cluster is None:
        if not 1 <= workers <= lag:
            raise UsageError(f'workers {workers}: needs to be within 1..{lag}')
        return dataclasses.replace(campaign, workers=workers)
    if workers != 1:
        raise UsageError(
            f'workers {workers}: not with a cluster, whose own workers are used; leave it out'
        )
    for role, word in (('perception', campaign.perception), ('controller', campaign.controller)):
        if word in (EXTERNAL, ''):
            raise UsageError(
                f'cluster: not with a {role} that you start yourself, which the workers do not '
                'see; use workers, or give its command'
            )
    if again := find_world(campaign.world).again_words:
        raise UsageError(f'cluster: {again}, so workers would not give the same runs')
    from taxinet_ros.trials.cluster.pool import check_cluster  # which imports asyncio

    return dataclasses.replace(campaign, cluster=check_cluster(cluster))


_POLL_S = 0.2


class RunSource(Protocol):
    """Source of the next run: an engine, or what stands around one."""

    @property
    def interrupted(self) -> bool:
        """Whether to end the runs in flight and start no others."""

    def next(self) -> RunRequest | None:
        """The next run to start; None if none is ready or there are no more."""

    def take(self, request: RunRequest, result: RunResult) -> object:
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
    """Make the runs of an open campaign to its end, or until an interrupt and their ends.

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
