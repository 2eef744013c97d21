"""A plain campaign, whose scenes are drawn from the program one by one.

A campaign's folder contains ``campaign.db`` (the record: options, program text and rows), one bag
folder per run, and ``runs.csv``/``runs.parquet`` (made from the record).
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

from taxinet_ros.core.pacing.timing import timing_words
from taxinet_ros.core.verdict.judge import SpecCheck
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.scenes.source import Rejected, SceneSource, first_scene, some_scenes
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.book import CampaignBook
from taxinet_ros.trials.record.facts import campaign_facts
from taxinet_ros.trials.record.row import RunRow

PATIENCE = 2
"""Number of consecutive infrastructure errors that end a plain campaign, which has no retries."""


class Campaign:
    """Requests runs and takes their results. A context manager that owns the Scenic process.

    Attributes:
        rows: one row per run taken, in order.
        notes: warnings about the program; only within the ``with``.
        book: the campaign on disk.
        check: result of checking the requirements; only within the ``with``.
    """

    def __init__(
        self, options: CampaignOptions, participants: tuple[str, ...],
        on_row: Callable[[RunRow], None] = lambda row: None,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Create it; nothing is started or written before the ``with``.

        Args:
            options: options of the campaign.
            participants: names of the nodes in every run.
            on_row: called with each row as soon as it is on disk.
            meanwhile: called while the program's process starts, which takes seconds.
        """
        self.options = options
        self.rows: list[RunRow] = []
        self.notes: tuple[str, ...] = ()
        self.check: SpecCheck
        self.book = CampaignBook(options, participants, on_row)
        self._source = SceneSource(
            options.program, seed=options.seed, overrides=options.overrides,
            laid_over=options.laid_over, meanwhile=meanwhile,
        )
        self._refused: dict[int, int] = {}
        self._next = 0
        self._interrupted = False
        self._timing: str | None = None

    def __enter__(self) -> Self:
        """Compile the program, draw the first scene, then create the folder.

        Raises:
            UsageError: the program does not compile, the requirements do not fit its runs, or the
                folder cannot be created.
        """
        with contextlib.ExitStack() as opened:
            opened.enter_context(self._source)
            self.check = self.options.check(
                first_scene(self._source), lambda: self._source.search_space().drawn,
                some_scenes(self._source, self.options.runs),
            )
            self.notes = self._source.drawn_notes
            facts = campaign_facts(self.options, self._source.program, self._source.text)
            opened.enter_context(self.book)
            self.book.begin({**facts, 'warnings': list(self.check.warnings)})
            self._opened = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of all runs so far, even after an error."""
        self._opened.__exit__(kind, error, trace)

    @property
    def unfinished(self) -> bool:
        """Whether there are runs left."""
        return (
            self._next < self.options.runs and self.book.broken_in_a_row < PATIENCE
            and not self._interrupted and not self.book.difference
        )

    def requests(self) -> Iterator[RunRequest]:
        """Yield the remaining runs, drawn one at a time; rejected scenes become rows."""
        while self._next < self.options.runs:
            index = self._next
            self._next += 1
            try:
                scenario = self._source.scene(index)
            except Rejected as error:
                self._refused[index] = error.refused
                self._keep(self.book.rejected_row(index, str(error)))
                continue
            self._refused[index] = self._source.refused
            yield self.book.begin_run(index, scenario)

    def take(self, request: RunRequest, result: RunResult) -> bool:
        """Record one result; False if the graph should be abandoned."""
        if result.outcome.judged:
            self._timing = result.timing if self._timing is None else self._timing
            if result.timing != self._timing:
                raise UsageError(
                    f'the graph now has {timing_words(result.timing)}, but earlier runs had '
                    f'{timing_words(self._timing)}: they cannot be mixed; start another campaign'
                )
        self._keep(self.book.finished_row(request, result))
        self._interrupted = result.outcome is Outcome.INTERRUPTED
        return result.outcome is not Outcome.INFRA_ERROR and not self._interrupted

    def _keep(self, row: RunRow) -> None:
        row = dataclasses.replace(row, refused=self._refused.pop(row.index, 0))
        self.rows.append(row)
        self.book.keep(row)


def exit_code(rows: list[RunRow]) -> ExitCode:
    """Exit code for a campaign's rows.

    Returns:
        0 all satisfied, 1 some violated, 4 infrastructure error, 130 interrupted.

    Raises:
        UsageError: no scene could be run.
    """
    outcomes = {row.outcome for row in rows}
    if Outcome.INTERRUPTED in outcomes:
        return ExitCode.INTERRUPTED
    if Outcome.INFRA_ERROR in outcomes:
        return ExitCode.INFRA
    if Outcome.FAIL in outcomes:
        return ExitCode.VIOLATED
    if Outcome.PASS not in outcomes:
        why = f'; the first: {rows[0].detail}' if rows else ''
        raise UsageError(f'no run could be judged: every scene was rejected{why}')
    return ExitCode.OK
