"""A search: a sampler chooses scenes and learns from their results; it can be resumed.

A search's folder is a campaign folder (:mod:`.campaign`). Runs may be concurrent and end in any
order; the sequence of scenes depends neither on this nor on the number of resumptions. The end of
the module has the printed lines of a search.
"""

from __future__ import annotations

import contextlib
import json
import statistics
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Self

import numpy as np

from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.verdict.judge import SpecCheck
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.covering import Covering
from taxinet_ros.samplers.registry import (
    SAMPLERS,
    check_sampler,
    drawn_share,
    make_covering_sampler,
    make_sampler,
)
from taxinet_ros.samplers.sampler import Exhausted, Lagged, Probabilities, Sampler
from taxinet_ros.samplers.space import Branch, Point, Space
from taxinet_ros.scenes.search_space import SearchSpace
from taxinet_ros.scenes.source import (
    Refused,
    Rejected,
    SceneSource,
    accepted_scene,
    first_scene,
    some_scenes,
)
from taxinet_ros.scenes.values import REJECTION_FEEDBACK
from taxinet_ros.trials.rates import count_outcomes, failure_rate, off_runway_rate
from taxinet_ros.trials.record.book import CampaignBook
from taxinet_ros.trials.record.facts import (
    ODD,
    UNTIL,
    campaign_facts,
    extension_facts,
    planned_runs,
)
from taxinet_ros.trials.record.resumption import EarlierRuns, earlier_runs, facts_of_graph
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.search_options import (
    COVERAGE,
    FAILURES,
    SearchOptions,
    with_sampler,
)
from taxinet_ros.trials.summary import (
    ON_STANDING_GRAPH,
    blind_words,
    next_line,
    off_runway_words,
    participants_words,
    refused_words,
    rho_words,
    scene_words,
    stopped_words,
    table_line,
)

PATIENCE = 3
"""Number of consecutive infrastructure errors in one session that end the search."""


class Search:
    """Requests runs and records their results. A context manager that owns the Scenic child.

    Attributes:
        options: options of the search; within the ``with``, including the program's sampler.
        notes: notes on the origin of the sampler and on likely mistakes in the program.
        rows: one row per completed run, in order of completion; after the ``with``, also those of
            earlier runs with an infrastructure error that were not retried.
        stopped: the rule that ended the search early, or ''.
        exhausted: whether the sampler had no more points.
        interrupted: whether :meth:`interrupt` was called.
        check: result of checking the requirements; only within the ``with``.
        book: the search on disk.
        covering: the sampler that covers an ODD, or None.
    """

    def __init__(
        self, options: SearchOptions, participants: tuple[str, ...],
        on_row: Callable[[RunRow], None] = lambda row: None,
    ) -> None:
        """Create it; nothing is started or written before the ``with``.

        Args:
            options: options of the search.
            participants: names of the nodes in every run.
            on_row: called with each new row once it is on disk; not with earlier ones.
        """
        self.options = options
        self.notes: tuple[str, ...] = ()
        self.rows: list[RunRow] = []
        self.check: SpecCheck
        self.stopped = ''
        self.exhausted = False
        self.interrupted = False
        self.covering: Covering | None = None
        self._campaign = options.campaign
        self.book = CampaignBook(self._campaign, participants, on_row, resume=options.resume)
        self._source = SceneSource(
            self._campaign.program, seed=self._campaign.seed,
            overrides=self._campaign.overrides, laid_over=self._campaign.laid_over,
        )
        self._headline = self._campaign.judging.headline
        self._points: dict[int, Point] = {}
        self._refused: dict[int, int] = {}
        self._earlier = EarlierRuns()
        self._asked = 0

    def __enter__(self) -> Self:
        """Compile the program, draw the first scene, then open the folder.

        Raises:
            UsageError: the program does not compile or makes no choices, there is no such sampler,
                the folder cannot be used, or contains another search.
        """
        self.book.check_folder()
        with contextlib.ExitStack() as opened:
            opened.enter_context(self._source)
            self._prepare()
            opened.enter_context(self.book)
            asked = self._asked_facts()
            self._earlier = earlier_runs(self._campaign.out, self.book.earlier, asked)
            self.book.begin({**asked, **self._earlier.facts})
            self._opened = opened.pop_all()
        self._begun = time.monotonic()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of the rows so far, even after an error."""
        counted = {row.index for row in self.rows}
        self.rows += [
            row for index, row in sorted(self.book.rows.items())
            if index not in counted and row.outcome is not Outcome.INTERRUPTED
        ]
        broken = self.book.difference or self.book.broken_in_a_row >= PATIENCE
        self.book.complete = len(self.book.rows) >= self._campaign.runs or bool(
            self.stopped and not self.interrupted and not broken
        )
        self._opened.__exit__(kind, error, trace)

    @property
    def space(self) -> SearchSpace:
        """The search space; only within the ``with``."""
        return self._source.search_space()

    def next(self) -> RunRequest | None:
        """The next run to start; None if none is ready or the search has ended.

        Raises:
            UsageError: the program failed.
        """
        if not self.interrupted and (request := self.book.next_retry()) is not None:
            return request
        try:
            while self._sampler.ready and self._wants_more():
                index, self._points[index] = self._sampler.next()
                request = self._choose(index)
                self._asked = index + 1
                if request is not None:
                    return request
        except Exhausted as error:
            self.stopped, self.exhausted = str(error), True
        return None

    def take(self, request: RunRequest, result: RunResult) -> None:
        """Record one result; a run with an infrastructure error is retried once.

        Raises:
            UsageError: it is from another perception than earlier results; it is not recorded.
        """
        if news := facts_of_graph(self._campaign.out, self.book.facts, result):
            self.book.add_facts(news)
        if not self.book.second_chance(request, result):
            self._keep(self.book.finished_row(request, result))
        self.stopped = self.book.difference or self.stopped

    def interrupt(self) -> None:
        """Request no more runs or retries; safe to call from a signal handler."""
        self.interrupted = True

    @property
    def perception(self) -> str:
        """Name of the perception; '' before a standing graph has answered."""
        return str(self.book.facts['perception'])

    @property
    def first_planned(self) -> range | None:
        """Indices of the runs planned before the first one; only within the ``with``."""
        return planned_runs(self.book.facts)

    def ended_sampler(self) -> Sampler:
        """The sampler with all results, after the last run; only within the ``with``."""
        return self._sampler.ended()

    def learned(self) -> Probabilities:
        """The sampler's failure histograms; empty if it has none."""
        return self._sampler.learned()

    # Asking ------------------------------------------------------------------------------------

    def _wants_more(self) -> bool:
        """Whether one more run is needed; runs started earlier are always finished first."""
        if (broken := self.book.broken_in_a_row) >= PATIENCE:
            self.stopped = f'{broken} runs in a row were broken by the bench'
        if self._asked >= self._campaign.runs or self.interrupted:
            return False
        if self._asked >= self._earlier.begun:
            self.stopped = self.stopped or self._stop_reason()
        return not self.stopped

    def _stop_reason(self) -> str:
        options = self.options
        # Uses the results that the next run depends on, so it is independent of the workers.
        known = [row for row in self.rows if row.index < self._sampler.due]
        if options.stop is not None and options.stop.is_met(known):
            return options.stop.reached
        if options.budget_s is not None and time.monotonic() - self._begun > options.budget_s:
            return f'the budget of {options.budget_s / 60:g} min is spent'
        return ''

    def _choose(self, index: int) -> RunRequest | None:
        """The run at the sampler's next point; None if it is rejected or done."""
        return None if self._replay(index) else self._draw(index)

    def _replay(self, index: int) -> bool:
        row = self._earlier.rows.get(index)
        if row is None:
            return False
        for _ in range(row.refused):
            self._points[index] = self._sampler.again(self._source.feedback)
        self._refused[index] = row.refused
        if row.point != self.space.named(self._points[index]):
            raise UsageError(
                f'--resume: the sampler chose another point for run {index} than before; was a '
                'library updated meanwhile? Name another --out'
            )
        self._remember(row)
        return True

    def _draw(self, index: int) -> RunRequest | None:
        """The run at the first of the sampler's points that meets the program's requirements."""
        def again() -> Point:
            self._points[index] = self._sampler.again(self._source.feedback)
            return self._points[index]

        try:
            scenario, self._refused[index] = accepted_scene(
                self._source, index, self._points[index], again
            )
        except Rejected as error:
            self._refused[index] = error.refused
            self._keep(self.book.rejected_row(index, str(error)))
            return None
        return self.book.begin_run(index, scenario)

    # Answers -----------------------------------------------------------------------------------

    def _keep(self, row: RunRow) -> None:
        row = row.with_choice(
            sampler=self.options.sampler, point=self.space.named(self._points[row.index]),
            weight=self._weight(row.index), drawn=self._sampler.drawn(row.index),
            refused=self._refused[row.index], retries=self._retries(row.index),
        )
        self._remember(row)
        self.book.keep(row)

    def _retries(self, index: int) -> int:
        """Number of retries of a run after infrastructure errors, including earlier sessions."""
        before = self._earlier.to_repeat.get(index)
        broken = before is not None and before.outcome is Outcome.INFRA_ERROR
        return (before.retries if before else 0) + broken + self.book.was_retried(index)

    def _weight(self, index: int) -> float | None:
        """Density of the program's distribution over the sampler's at a run's point, if known.

        With soft requirements, the density of accepted points is unknown unless the sampler draws
        from the program's distribution: it depends on the probabilities that points of the sampler
        and of the program meet this run's requirements.
        """
        weight = self._sampler.weight(index)
        return None if self.space.soft and weight != 1 else weight

    def _remember(self, row: RunRow) -> None:
        self.rows.append(row)
        if row.outcome is not Outcome.INTERRUPTED:
            unknown = row.index in self._earlier.unknown_to_sampler
            known = None if unknown else row.robustness_for_sampler(self._headline)
            if row.outcome is Outcome.REJECTED and self._sampler.hears_refusals:
                known = self._source.feedback
            self._sampler.tell(row.index, known)

    # Beginning ---------------------------------------------------------------------------------

    def _prepare(self) -> None:
        self.options, whose = with_sampler(self.options, self._source.sampler)
        options, campaign = self.options, self._campaign
        space = self._source.space()
        self.notes = (*self._source.notes, *([whose] if whose else []))
        self._sampler = self._make_sampler(space)
        if self._source.feedback is not None and not self._sampler.hears_refusals:
            self.notes += (f'{REJECTION_FEEDBACK} has no effect on {options.sampler}, which does '
                           'not learn from refused points',)
        if options.in_flight is None:
            self._sampler.ignore_results()
        else:
            self._sampler.set_lag(options.lag)
        if options.stop is not None and options.stop.needs_draws and not drawn_share(
            options.sampler, options.sampler_options
        ):
            raise UsageError(
                f'--until {options.stop}: no rate is known with {options.sampler}, which chooses '
                'all of its runs; add --sampler-option floor=0.3, or use failures=K'
            )
        self.check = campaign.check(
            first_scene(self._source), lambda: self._source.search_space().drawn,
            some_scenes(self._source, campaign.runs),
        )

    def _make_sampler(self, space: Space) -> Lagged:
        options, campaign, odd = self.options, self._campaign, self.options.odd
        names: dict[str, Any] = dict(options.sampler_options)
        if odd is None:
            return make_sampler(options.sampler, space, campaign.seed, campaign.runs, **names)
        strength = int(check_sampler(options.sampler, names)['strength'])
        if strength > len(odd.parameters):
            raise UsageError(
                f'--sampler-option strength={strength}: the ODD {odd.name} has only '
                f'{len(odd.parameters)} parameters'
            )

        def cells(point: Point) -> tuple[int, ...] | None:
            # What the point leaves open is drawn as for scene 0, so that a resumed search agrees.
            try:
                scene = self._source.scene(0, point).to_human()
            except (Refused, Rejected):
                return None
            return odd.inside(scene)

        sampler, self.covering = make_covering_sampler(
            space, campaign.seed, odd.feasible(strength), cells, **names
        )
        return sampler

    def _asked_facts(self) -> dict[str, Any]:
        campaign = self._campaign
        word = campaign.perception
        facts = campaign_facts(campaign, self._source.program, self._source.text)
        return {
            **facts,
            **extension_facts(facts, samplers=self.options.sampler),
            'first_runs': campaign.runs,
            'warnings': list(self.check.warnings),
            'perception_sha256': (
                '' if campaign.standing_graph else check_perception(word, graph=True)
            ),
            'sampler': self.options.sampler,
            'sampler_options': dict(self.options.sampler_options),
            # A sampler in batches waits for whole ones, whatever the lag.
            'sampler_lag': 1 if SAMPLERS[self.options.sampler].batched else self.options.lag,
            'dimensions': [dimension.name for dimension in self._source.space()],
            # Only the grid depends on the number of runs; the others can be extended.
            'grid_runs': campaign.runs if self.options.sampler == 'grid' else None,
            **({ODD: json.loads(self.options.odd.text)} if self.options.odd is not None else {}),
            **({UNTIL: [str(self.options.stop)]} if self.options.stop is not None else {}),
        }


def search_heading(options: SearchOptions) -> str:
    """Heading that describes the search."""
    campaign = options.campaign
    workers = '1 worker' if options.workers == 1 else f'{options.workers} workers'
    workers = f'cluster {options.cluster}' if options.cluster else workers
    verb = 'resuming' if options.resume else 'searching'
    graph = f'{participants_words(campaign)}, {workers}'
    return (
        f'{verb} {campaign.program} for failures: up to {campaign.runs} runs, sampler '
        f'{options.sampler}, seed {campaign.seed}, '
        f'{ON_STANDING_GRAPH if campaign.standing_graph else graph} -> {campaign.out}'
    )


def space_lines(space: SearchSpace) -> list[str]:
    """Lines on the choices that the sampler controls, with conditions, and on the others."""
    options = {choice.dimension.name: choice.options for choice in space.searched}
    groups: dict[str, list[str]] = {}
    for choice in space.searched:
        where = ' or '.join(_branch_words(branch, options[branch.parent])
                            for branch in choice.dimension.when)
        groups.setdefault(f'where {where}: ' if where else '', []).append(choice.dimension.name)
    searched = '; '.join(f'{where}{", ".join(names)}' for where, names in groups.items())
    lines = [f'searched: {searched or "nothing"}']
    if space.unsearched:
        lines.append(f'drawn, not searched: {", ".join(space.unsearched)}')
    return lines


def _branch_words(branch: Branch, options: Sequence[object]) -> str:
    named = [str(options[number]) if options else f'option {number + 1}'
             for number in branch.categories]
    return f'{branch.parent} is {" or ".join(named)}'


def search_summary(search: Search, resuming: str = '--resume') -> list[str]:
    """Summary lines: counts, rates with intervals, the worst run, path of the table.

    Args:
        search: a search that has ended.
        resuming: option that continues it.
    """
    rows, campaign = search.rows, search.options.campaign
    lines = [count_outcomes(rows) or 'no run ended']
    lines += [*_rate_lines(search), *stopped_words(rows), *refused_words(rows)]
    lines += [*blind_words(rows), *_worst_line(rows), *_odd_lines(search)]
    lines.append(table_line(rows, campaign))
    lines += next_line(rows, campaign)
    why = 'interrupted' if search.interrupted else search.stopped
    if why and len(rows) < search.options.runs:
        how = '' if search.exhausted else f'; {resuming} continues it'
        lines.append(f'ended before its {search.options.runs} runs: {why}{how}')
    elif any(row.outcome is Outcome.INFRA_ERROR for row in rows):
        lines.append(f'{resuming} tries the runs again that the bench broke')
    return lines


def _rate_lines(search: Search) -> list[str]:
    rows, planned = search.rows, search.first_planned
    judged = [row for row in rows if row.outcome.judged]
    if not judged:
        return []
    failed, off = failure_rate(rows, planned), off_runway_rate(rows, planned)
    speed = statistics.median(row.real_time_factor for row in judged)
    failures = sum(row.outcome is Outcome.FAIL for row in judged)
    made = f'{failures} of {len(judged)} judged runs failed'
    if failed.rate is None:
        return [
            failed.why_not, f'{made}, {off_runway_words(judged)}, median {speed:.1f}x real time',
        ]
    left = '' if off is None or off.rate is None else f', off the runway {off.rate.words()}'
    lines = [
        f'under the program itself: satisfied {failed.rate.other.words()}{left} '
        f'({failed.rests_on})',
        f'{made}, median {speed:.1f}x real time',
    ]
    stop = search.options.stop
    if stop is not None and stop.kind == FAILURES and search.stopped == stop.reached:
        lines.append('it ended with a failure, so the share of failures is too high on average; '
                     'the interval holds all the same')
    return lines


def _worst_line(rows: Sequence[RunRow]) -> list[str]:
    judged = [row for row in rows if row.outcome.judged]
    if not judged:
        return []
    worst = min(judged, key=lambda row: row.headline[::-1] if row.headline else ())
    return [f'worst: run {worst.index}, {rho_words(worst)}: {scene_words(worst)}']


_COMBINATIONS = {1: 'cells', 2: 'pairs of cells', 3: 'triples of cells'}
_MOST_UNSEEN = 5


def _odd_lines(search: Search) -> list[str]:
    """What the judged runs cover of the ODD, and what the program was not seen to reach."""
    odd, covering = search.options.odd, search.covering
    if odd is None or covering is None:
        return []
    reach = covering.reach()
    strength = int(check_sampler(COVERAGE, search.options.sampler_options)['strength'])
    feasible = odd.feasible(strength)
    covered = {each: np.zeros(mask.shape, dtype=bool) for each, mask in feasible.items()}
    judged = [row for row in search.rows if row.outcome.judged]
    places = [odd.inside(row.scene) for row in judged]
    for place in places:
        if place is not None:
            for each, mask in covered.items():
                mask[tuple(place[one] for one in each)] = True
    done = sum(int((feasible[each] & mask).sum()) for each, mask in covered.items())
    outside = places.count(None)
    what = _COMBINATIONS[strength]
    lines = [
        f'ODD {odd.name}: {done:,} of {reach.wanted:,} {what} in a judged run'
        + (f'; {outside:,} judged runs outside' if outside else '')
    ]
    if reach.unseen:
        named = '; '.join(odd.words(*one) for one in reach.unseen[:_MOST_UNSEEN])
        more = len(reach.unseen) - _MOST_UNSEEN
        lines.append(
            f'not reached by the program in {reach.points:,} scenes looked at: '
            f'{len(reach.unseen):,} ({named}' + (f'; and {more:,} more)' if more > 0 else ')')
        )
    return lines
