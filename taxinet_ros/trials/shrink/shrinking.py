"""Shrinking of a failed run: a campaign whose scenes :mod:`.algorithm` chooses.

Its folder is a campaign folder. The next run depends only on the results, so a resumed shrinking
reads them from its record and continues. Runs without a verdict are repeated under their old
numbers, so the table equals that of an uninterrupted one. The second half of the module reports the
results for each parameter.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from rich.table import Table
from rich.text import Text

from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import BY_KEY, RAIN_CLOUDS
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.trials.record.book import CampaignBook, check_same_campaign
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import facts_of_runs
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.run_command import RunSettings
from taxinet_ros.trials.shrink.algorithm import End, Point, ShrinkSearch, State
from taxinet_ros.trials.shrink.options import PROGRAM, STEPS, Parameter, ShrinkOptions
from taxinet_ros.trials.summary import participants_words, scene_words


class Shrinking:
    """Requests runs and records their results; a context manager.

    Attributes:
        options: options of the shrinking.
        search: search state.
        rows: one row per completed run, including earlier ones, in the order in which they were
            needed or ended.
        broken: the run with a permanent infrastructure error, or None.
        interrupted: whether :meth:`interrupt` was called.
        book: the shrinking on disk.
    """

    def __init__(
        self, options: ShrinkOptions, participants: tuple[str, ...],
        on_row: Callable[[RunRow], None] = lambda row: None,
    ) -> None:
        """Create the shrinking; nothing is written before the ``with``.

        Args:
            options: options of the shrinking.
            participants: names of the nodes in every run.
            on_row: called with each new row once it is on disk; not with earlier ones.
        """
        self.options = options
        self.search = ShrinkSearch(
            [one.axis for one in options.space.moving], most=options.campaign.runs,
            rule=options.space.possible,
        )
        self.rows: list[RunRow] = []
        self.broken: RunRow | None = None
        self.interrupted = False
        self._campaign = options.campaign
        self.book = CampaignBook(self._campaign, participants, on_row, resume=options.resume)
        self._earlier: dict[str, RunRow] = {}
        self._by_point: dict[Point, RunRow] = {}
        self._under_way: dict[int, Point] = {}
        self._broken_before: dict[str, int] = {}
        self._undone: list[int] = []
        self._next = 0

    def __enter__(self) -> Self:
        """Create the folder, or check that it contains this shrinking.

        Raises:
            UsageError: the folder cannot be used, or contains something else.
        """
        facts = self._facts()
        with contextlib.ExitStack() as opened:
            opened.enter_context(self.book)
            check_same_campaign(self._campaign.out, self.book.earlier, facts)
            self._take_up(self.book.earlier)
            self.book.begin(facts)
            opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of the rows so far, even after an error."""
        self.book.complete = not self.interrupted and self.search.state.end is not End.NOT_YET
        self.book.__exit__(kind, error, trace)

    def next(self) -> RunRequest | None:
        """The next run to start; None if none is ready or the search has ended."""
        if self.interrupted or self.broken is not None:
            return None
        if (request := self.book.next_retry()) is not None:
            return request
        while (point := self._next_point()) is not None:
            row = self._earlier.get(self._key(point))
            if row is None:
                return self._begin(point)
            self._remember(point, row)
        return None

    def take(self, request: RunRequest, result: RunResult) -> None:
        """Record one result; an infrastructure error is retried once, then ends the shrinking."""
        if self.book.second_chance(request, result):
            return
        index = request.index
        key = self._key(self._under_way[index])
        row = self.book.finished_row(request, result).with_choice(
            sampler=PROGRAM, point={}, weight=None,
            retries=self._broken_before.get(key, 0) + self.book.was_retried(index),
        )
        point = self._under_way.pop(index)
        if row.outcome.judged:
            self._remember(point, row)
        elif row.outcome is Outcome.INTERRUPTED:
            self.interrupted = True
        else:
            self.broken = row
        self.book.keep(row)

    def interrupt(self) -> None:
        """Request no more runs or retries; safe to call from a signal handler."""
        self.interrupted = True

    def row(self, point: Point) -> RunRow | None:
        """The judged run of a point, or None."""
        return self._by_point.get(point)

    def _next_point(self) -> Point | None:
        """The most urgent point that is not in flight, or one that may be needed later."""
        under_way = set(self._under_way.values())
        wanted = self.search.wanted(len(under_way) + 1)
        return next((point for point in wanted if point not in under_way), None)

    def _begin(self, point: Point) -> RunRequest:
        if self._undone:
            index = self._undone.pop(0)
        else:
            index, self._next = self._next, self._next + 1
        scenario = self.options.space.scenario(point)
        request = self.book.begin_run(index, scenario)
        self._under_way[index] = point
        return request

    def _remember(self, point: Point, row: RunRow) -> None:
        self.rows.append(row)
        self._by_point[point] = row
        self.search.tell(point, row.rho[self.options.headline])

    def _key(self, point: Point) -> str:
        return json.dumps(self.options.space.scenario(point).to_human())

    def _take_up(self, content: CampaignContent) -> None:
        """Load earlier results, and the runs that they left unfinished."""
        known = (*content.unfinished, *(row.index for row in content.rows))
        self._next = 1 + max(known, default=-1)
        self._earlier = {_scene(row): row for row in content.rows if row.outcome.judged}
        undone = [row for row in content.rows if not row.outcome.judged]
        judged = {row.index for row in content.rows if row.outcome.judged}
        self._undone = sorted(set(range(self._next)) - judged)
        self._broken_before = {
            _scene(row): row.retries + (row.outcome is Outcome.INFRA_ERROR) for row in undone
        }

    def _facts(self) -> dict[str, Any]:
        space, perception = self.options.space, self._campaign.perception
        return facts_of_runs(self._campaign, {
            'program': PROGRAM,
            'shrinks': self.options.run.run_id,
            'original': space.original.to_human(),
            'nominal': space.nominal.to_human(),
            'parameters': [one.key for one in space.parameters],
            'steps': STEPS,
            'perception_sha256': check_perception(perception, graph=True),
        })


def _scene(row: RunRow) -> str:
    """Key of a run's scene, see :meth:`Shrinking._key`."""
    return json.dumps(row.scene)


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """Result for one parameter, in human units; None for values that were not run.

    Attributes:
        key: name of the parameter.
        original, nominal, shrunk: its value in the failed, the nominal and the shrunk scenario.
        rho_in_original, rho_in_shrunk: robustness of either with this parameter set to nominal.
        passes_at: the value one step nearer to nominal than ``shrunk``, if it passes.
        rho_passes_at: robustness there, above 0.
    """

    key: str
    original: Any
    nominal: Any
    shrunk: Any
    rho_in_original: float | None = None
    rho_in_shrunk: float | None = None
    passes_at: Any = None
    rho_passes_at: float | None = None

    @property
    def off_nominal(self) -> bool:
        """Whether it differs from nominal in the shrunk scenario."""
        return bool(self.shrunk != self.nominal)

    @property
    def matters(self) -> bool | None:
        """Whether the shrunk scenario passes with it at nominal; None if that was not run."""
        if not self.off_nominal:
            return False
        return None if self.rho_in_shrunk is None else self.rho_in_shrunk > 0

    def words(self, value: Any) -> str:
        """A value of the parameter, with its unit."""
        return BY_KEY[self.key].value_words(value)


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """Result of a shrinking.

    Attributes:
        state: progress of the search, and why it ended.
        findings: one for each parameter.
        scenario: the shrunk scenario.
        original, nominal, shrunk: rows of the three runs; None if missing.
        dry: whether nominal clouds also remove the rain, since no rain falls from that sky.
    """

    state: State
    findings: tuple[Finding, ...]
    scenario: Scenario
    original: RunRow | None
    nominal: RunRow | None
    shrunk: RunRow | None
    dry: bool


def make_report(shrinking: Shrinking) -> Report:
    """Report of the results so far."""
    space, search = shrinking.options.space, shrinking.search
    state = search.state
    axes = {one.key: number for number, one in enumerate(space.moving)}
    return Report(
        state=state,
        findings=tuple(
            _finding(shrinking, one, axes[one.key], state.at) if one.key in axes
            else Finding(key=one.key, original=one.values[0], nominal=one.values[0],
                         shrunk=one.values[0])
            for one in space.parameters
        ),
        scenario=space.scenario(state.at),
        original=shrinking.row(search.start), nominal=shrinking.row(search.origin),
        shrunk=shrinking.row(state.at),
        dry=space.original.rain_fraction > 0 and space.nominal.clouds not in RAIN_CLOUDS,
    )


def _finding(shrinking: Shrinking, one: Parameter, axis: int, at: Point) -> Finding:
    search, steps = shrinking.search, at[axis]
    beside = search.rho(search.moved(at, axis, steps - 1)) if steps else None
    passes = beside if beside is not None and beside > 0 else None
    return Finding(
        key=one.key, original=one.values[-1], nominal=one.values[0], shrunk=one.values[steps],
        rho_in_original=search.rho(search.moved(search.start, axis, 0)),
        rho_in_shrunk=search.rho(search.moved(at, axis, 0)) if steps else None,
        passes_at=None if passes is None else one.values[steps - 1], rho_passes_at=passes,
    )


_MATTERS = {
    True: Text('matters', style='bold red'), False: Text('does not matter', style='dim'),
    None: Text('not known', style='dim'),
}


def shrink_heading(options: ShrinkOptions) -> str:
    """Heading that describes the shrinking."""
    campaign, run = options.campaign, options.run
    workers = '1 worker' if options.workers == 1 else f'{options.workers} workers'
    workers = f'cluster {options.cluster}' if options.cluster else workers
    verb = 'resuming to shrink' if options.resume else 'shrinking'
    interval = run.robustness.get(options.headline)
    rho = f', {interval.bound_words()}' if interval else ''
    return (
        f'{verb} {run.run_id} ({options.headline}{rho}), {participants_words(campaign)}, '
        f'{workers} -> {campaign.out}'
    )


def parameter_table(report: Report) -> Table:
    """Every parameter with its three values, and whether it matters."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column('parameter', no_wrap=True)
    for name in ('original', 'nominal', 'shrunk', 'rho in\noriginal', 'rho in\nshrunk'):
        table.add_column(name, justify='right', no_wrap=True)
    table.add_column('verdict', no_wrap=True)
    for one in report.findings:
        verdict = _MATTERS[one.matters]
        if one.original == one.nominal:
            verdict = Text('nominal already', style='dim')
        table.add_row(
            one.key, one.words(one.original), one.words(one.nominal), one.words(one.shrunk),
            _rho(one.rho_in_original), _rho(one.rho_in_shrunk), verdict,
        )
    return table


def finding_lines(report: Report) -> list[str]:
    """Lines that explain the table and where the failure begins."""
    lines = ['rho in original, in shrunk: of that run with this one parameter made nominal']
    if report.dry:
        lines[0] += ' (a clear sky is dry too)'
    for one in report.findings:
        if one.matters and one.passes_at is not None and one.rho_passes_at is not None:
            lines.append(f'{one.key}: {edge_words(one)}')
        if one.matters and one.rho_in_original is not None and one.rho_in_original <= 0:
            lines.append(f'{one.key}: the original fails without it too, so it has another cause')
    return lines


def edge_words(one: Finding) -> str:
    """Text on where the failure begins along one parameter, others as in the shrunk run."""
    fails, passes = one.words(one.shrunk), one.words(one.passes_at)
    return f'{fails} fails, {passes} passes (rho {one.rho_passes_at:+.2f})'


def off_nominal(report: Report) -> str:
    """Short description of the shrunk scenario: its parameters that are not nominal."""
    words = [
        f'{one.key} {one.words(one.shrunk)}' for one in report.findings if one.off_nominal
    ]
    return ', '.join(words) or 'everything nominal'


def result_lines(report: Report, options: ShrinkOptions, runs: int, wall_s: float) -> list[str]:
    """Lines on how the shrinking ended and its cost."""
    lines = [_ended(report)] if report.state.end is not End.MINIMAL else []
    if report.shrunk is not None:
        rho = report.shrunk.rho[options.headline]
        lines.append(
            f'shrunk: run {report.shrunk.index}, rho {rho:+.2f}: {scene_words(report.shrunk)}'
        )
    ahead = runs - report.state.asked
    guesses = f' ({ahead} of them ahead on a guess)' if ahead > 0 else ''
    took = ' in all' if options.resume else f' in {wall_s:.0f} s'
    lines.append(f'{runs} runs{guesses}{took}')
    return lines


def run_command(options: ShrinkOptions, program: str) -> str:
    """Shell command to run the shrunk scenario."""
    return RunSettings.of_options(options.campaign).command(program)


def _rho(value: float | None) -> str:
    return '' if value is None else f'{value:+.2f}'


def _ended(report: Report) -> str:
    if report.state.end is End.NOMINAL_FAILS:
        return 'the nominal scenario fails itself, so no parameter matters; see --nominal'
    if report.state.end is End.SPENT:
        return 'ended before it was minimal: --runs are spent; --resume with more goes on'
    return 'ended before it was minimal; --resume goes on'
