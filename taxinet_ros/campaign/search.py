"""A search on disk: a sampler chooses scenes, learns from their results, and may be interrupted.

A search's folder is a campaign's (:mod:`.campaign`). The runs may be under way at once and end in
any order; the sequence of scenes depends on neither, nor on how often the search was resumed.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from taxinet_ros.campaign.earlier import UNTOLD, Earlier, read_earlier
from taxinet_ros.campaign.facts import FACTS_NAME, STACKS, campaign_facts
from taxinet_ros.campaign.graph_perception import met
from taxinet_ros.campaign.put_aside import put_aside
from taxinet_ros.campaign.record import Record, check_resumable
from taxinet_ros.campaign.requests import finished_row, rejected_row, run_name, run_request
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.samplers.lagged import LAG
from taxinet_ros.campaign.samplers.make import drawn_share, make_sampler
from taxinet_ros.campaign.samplers.sampler import Exhausted, Probabilities
from taxinet_ros.campaign.samplers.space import Point
from taxinet_ros.campaign.scene_source import (
    Rejected,
    SceneSource,
    accepted_scene,
    first_duration_s,
)
from taxinet_ros.campaign.search_options import SearchOptions, with_sampler
from taxinet_ros.campaign.search_space import SearchSpace
from taxinet_ros.campaign.stop_rule import HALF_WIDTH
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.perception import check_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.spec_check import SpecCheck

PATIENCE = 3
"""After so many infrastructure errors in a row of one sitting the bench is broken, not the run."""


class Search:
    """Asks for runs and takes their answers. A context manager that owns the Scenic child.

    Attributes:
        options: what to do; within the ``with``, with the sampler that the program asks for.
        notes: lines on what is not as it may seem: whose sampler it is, what a program may mean.
        rows: one row per run that is done, in the order in which they were; after the ``with``,
            of earlier runs that the bench broke and that were not tried again, too.
        stopped: which rule ended the search before all its runs were done; '' where none did.
        exhausted: whether that was for want of other points.
        interrupted: whether :meth:`interrupt` was called.
        check: what is said of the requirements before the first run; only within the ``with``.
    """

    def __init__(
        self, options: SearchOptions, participants: tuple[str, ...],
        on_row: Callable[[RunRow], None] = lambda row: None,
    ) -> None:
        """Nothing is started or written before the ``with``.

        Args:
            options: what to do.
            participants: node names that take part in every run.
            on_row: called with each new row as soon as it is on disk; not with those of before.
        """
        self.options = options
        self.notes: tuple[str, ...] = ()
        self.rows: list[RunRow] = []
        self.check: SpecCheck
        self.stopped = ''
        self.exhausted = False
        self.interrupted = False
        self._campaign = options.campaign
        self._participants = participants
        self._on_row = on_row
        self._source = SceneSource(
            self._campaign.program, seed=self._campaign.seed,
            overrides=self._campaign.overrides, laid_over=self._campaign.laid_over,
        )
        self._specs = tuple(parse_spec(text) for text in self._campaign.specs)
        self._points: dict[int, Point] = {}
        self._refused: dict[int, int] = {}
        self._again: list[RunRequest] = []
        self._retried: set[int] = set()
        self._earlier = Earlier()
        self._attempts: Counter[int] = Counter()
        self._asked = 0
        self._due = False
        self._broken = 0

    def __enter__(self) -> Self:
        """Compile the program, draw the first scene, and only then touch the folder.

        Raises:
            UsageError: the program does not compile or makes no choices, there is no such sampler,
                the folder cannot be used, or what it holds is another search.
        """
        out = self._campaign.out
        if self.options.resume:
            check_resumable(out)
        self._source.__enter__()
        try:
            self._prepare()
            names = [spec.name for spec in self._specs]
            self._record = Record(out, names, resume=self.options.resume)
            try:
                self._take_up(self._asked_facts())
            except BaseException:
                self._record.close()
                raise
        except BaseException:
            self._source.__exit__(None, None, None)
            raise
        self._begun = time.monotonic()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of what there is, whatever happened."""
        self._source.__exit__(None, None, None)
        counted = {row.index for row in self.rows}
        self.rows += [
            row for index, row in sorted(self._record.rows.items())
            if index not in counted and row.outcome is not Outcome.INTERRUPTED
        ]
        try:
            if error is None:
                self._accept()
        finally:
            self._record.__exit__(kind, error, trace)

    @property
    def space(self) -> SearchSpace:
        """What is searched; only within the ``with``."""
        return self._source.search_space()

    def next(self) -> RunRequest | None:
        """A run to begin now; None where there is none before another run has ended, or at all.

        Raises:
            UsageError: the program failed.
        """
        if self._again and not self.interrupted:
            return self._again.pop()
        try:
            while self._sampler.ready and self._more():
                index, point = self._sampler.next()
                self._asked, self._points[index] = index + 1, point
                if self._replayed(index):
                    continue
                request = self._drawn(index)
                if request is not None:
                    return request
        except Exhausted as error:
            self.stopped, self.exhausted = str(error), True
        return None

    def take(self, request: RunRequest, result: RunResult) -> None:
        """Keep one answer. A run that the bench broke gets a second chance before that counts.

        Raises:
            UsageError: it comes from another perception than those before; it is not kept.
        """
        if news := met(self._campaign.out, self._facts, result):
            self._put_down({**self._facts, **news})
        if result.outcome is Outcome.INFRA_ERROR and request.index not in self._retried:
            self._retried.add(request.index)
            self._again.append(self._begin(request))
            return
        self._keep(finished_row(self._campaign, request, result))

    def interrupt(self) -> None:
        """Ask for no more runs, not for second chances either. A signal handler may call it."""
        self.interrupted = True

    @property
    def perception(self) -> str:
        """Word of the perception that is searched; '' before the graph that has it answers."""
        return str(self._facts['perception'])

    @property
    def first_planned(self) -> int:
        """Number of runs that were planned before the first of them; only within the ``with``."""
        return int(self._facts['first_runs'])

    @property
    def warning(self) -> str:
        """One line where earlier runs were made on another machine or version, or ''."""
        return self._earlier.warning

    @property
    def facts(self) -> dict[str, Any]:
        """What ``campaign.json`` says of the search; only within the ``with``."""
        return dict(self._facts)

    def learned(self) -> Probabilities:
        """Where the sampler has found failures; empty where it has no idea."""
        return self._sampler.learned()

    # Asking ------------------------------------------------------------------------------------

    def _more(self) -> bool:
        """Whether one more run is wanted. What was begun before is always finished first."""
        if self._broken >= PATIENCE:
            self.stopped = f'{self._broken} runs in a row were broken by the bench'
        if self._asked >= self._campaign.runs or self.interrupted:
            return False
        if self._asked >= self._earlier.begun:
            self.stopped = self.stopped or self._reason()
        return not self.stopped

    def _reason(self) -> str:
        options = self.options
        # By the results that the next run depends on, so workers make no difference.
        known = [row for row in self.rows if row.index < self._sampler.due]
        if options.stop is not None and options.stop.met(known):
            return options.stop.reached
        if options.budget_s is not None and time.monotonic() - self._begun > options.budget_s:
            return f'the budget of {options.budget_s / 60:g} min is spent'
        return ''

    def _replayed(self, index: int) -> bool:
        row = self._earlier.rows.get(index)
        if row is None:
            return False
        for _ in range(row.refused):
            self._points[index] = self._sampler.again()
        self._refused[index] = row.refused
        if row.point != self.space.named(self._points[index]):
            raise UsageError(
                f'--resume: the sampler chose another point for run {index} than before; was a '
                'library updated meanwhile? Name another --out'
            )
        self._remember(row)
        return True

    def _drawn(self, index: int) -> RunRequest | None:
        """The run at the first of the sampler's points that meets the program's requirements."""
        def again() -> Point:
            self._points[index] = self._sampler.again()
            return self._points[index]

        try:
            scenario, self._refused[index] = accepted_scene(
                self._source, index, self._points[index], again
            )
        except Rejected as error:
            self._refused[index] = error.refused
            self._keep(rejected_row(self._campaign, index, str(error)))
            return None
        request = run_request(self._campaign, index, scenario, self._participants)
        return self._begin(request, _digest(scenario))

    def _begin(self, request: RunRequest, scenario_sha256: str = '') -> RunRequest:
        """Put on record that a run begins, under the name that this attempt has."""
        self._accept()
        index = request.index
        self._attempts[index] += 1
        name = run_name(self._campaign, index, self._attempts[index])
        put_aside(self._campaign.out / name)
        self._record.intent(index, name, scenario_sha256)
        return dataclasses.replace(request, run_id=name)

    # Answers -----------------------------------------------------------------------------------

    def _keep(self, row: RunRow) -> None:
        self._accept()
        row = row.chosen(
            sampler=self.options.sampler, point=self.space.named(self._points[row.index]),
            weight=self._weight(row.index), drawn=self._sampler.drawn(row.index),
            refused=self._refused[row.index], retries=self._retries(row.index),
        )
        if row.outcome not in (Outcome.REJECTED, Outcome.INTERRUPTED):  # the bench had a part
            infra = row.outcome is Outcome.INFRA_ERROR
            self._broken = self._broken + 1 if infra else 0
        self._remember(row)
        try:
            self._record.result(row)
        finally:
            self._on_row(row)

    def _retries(self, index: int) -> int:
        """How often a run was begun anew because the bench broke, in earlier sittings too."""
        before = self._earlier.again.get(index)
        broken = before is not None and before.outcome is Outcome.INFRA_ERROR
        return (before.retries if before else 0) + broken + (index in self._retried)

    def _weight(self, index: int) -> float | None:
        """Density of the program's distribution over the sampler's at a run's point, if known.

        Where a requirement holds for a share of the runs only, the accepted points of a sampler
        with another distribution than the program's have a density that nobody knows: it depends
        on how likely the sampler and the program are to meet what this run has to meet.
        """
        weight = self._sampler.weight(index)
        return None if self.space.soft and weight != 1 else weight

    def _remember(self, row: RunRow) -> None:
        self.rows.append(row)
        if row.outcome is not Outcome.INTERRUPTED:
            untold = row.index in self._earlier.untold
            self._sampler.tell(row.index, None if untold else row.told(self._specs[0].name))

    # Beginning ---------------------------------------------------------------------------------

    def _prepare(self) -> None:
        self.options, whose = with_sampler(self.options, self._source.sampler)
        options, campaign = self.options, self._campaign
        space = self._source.space()
        self.notes = (*self._source.notes, *([whose] if whose else []))
        names: dict[str, Any] = dict(options.sampler_options)
        self._sampler = make_sampler(
            options.sampler, space, campaign.seed, campaign.runs, **names
        )
        if options.stop is not None and options.stop.kind == HALF_WIDTH and not drawn_share(
            options.sampler, options.sampler_options
        ):
            raise UsageError(
                f'--until {options.stop}: no rate is known with {options.sampler}, which chooses '
                'all of its runs; add --sampler-option floor=0.3, or use failures=K'
            )
        self.check = campaign.check(first_duration_s(self._source))

    def _take_up(self, asked: dict[str, Any]) -> None:
        """Go on where an earlier sitting ended, if there was one."""
        earlier = self._earlier = read_earlier(self._campaign.out, asked)
        self._attempts.update(earlier.attempts)
        self._record.rows.update({**earlier.rows, **earlier.again})
        untold = {UNTOLD: sorted(earlier.untold)} if earlier.untold else {}
        self._facts = {
            **asked, **earlier.facts, **untold, STACKS: {**earlier.stacks, **asked[STACKS]},
        }
        self._due = True
        if not earlier.rows or not (self._campaign.out / FACTS_NAME).is_file():
            self._put_down(self._facts)

    def _put_down(self, facts: dict[str, Any]) -> None:
        self._facts, self._due = facts, False
        self._record.facts(facts)

    def _accept(self) -> None:
        """Put down what is asked for now, once something is added to what there is.

        Until then a sampler that chooses other points than before refuses all of it.
        """
        if self._due:
            self._put_down(self._facts)

    def _asked_facts(self) -> dict[str, Any]:
        campaign = self._campaign
        word = campaign.perception
        return {
            **campaign_facts(campaign, self._source.program),
            'first_runs': campaign.runs,
            'warnings': list(self.check.warnings),
            'perception_sha256': (
                '' if campaign.standing_graph else check_perception(word, graph=True)
            ),
            'sampler': self.options.sampler,
            'sampler_options': dict(self.options.sampler_options),
            'sampler_lag': LAG,
            'dimensions': [dimension.name for dimension in self._source.space()],
            # Only the grid is laid out for a number of runs; the others may be asked for more.
            'grid_runs': campaign.runs if self.options.sampler == 'grid' else None,
        }


def _digest(scenario: Scenario) -> str:
    return hashlib.sha256(json.dumps(scenario.to_human()).encode()).hexdigest()
