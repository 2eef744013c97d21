"""A campaign on disk: its record, open for writing, and the table made from it.

The engine (:mod:`taxinet_ros.trials.engine`) makes the runs; the book names them, makes their rows
and keeps these. That a run begins is recorded before it, its result after it. If the record is
moved, deleted or replaced meanwhile, the campaign ends, since its verdicts would be lost.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from taxinet_ros.core.documents import NamedDocument
from taxinet_ros.core.provenance import Provenance, stack_id
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CATALOGUES
from taxinet_ros.core.types import NS_PER_S, step_stamp_ns
from taxinet_ros.core.user_code import is_node_elsewhere
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import RecordError, UsageError, warn_once
from taxinet_ros.files.atomic import disk_words
from taxinet_ros.files.record import RECORD_NAME, Record, repair_record, repaired
from taxinet_ros.trials.options import CampaignOptions, check_new, make_out
from taxinet_ros.trials.record.content import (
    AS_TEXT,
    DOCUMENT,
    END,
    REQUIREMENT,
    CampaignContent,
    StoredRows,
    campaign_content,
    run_key,
)
from taxinet_ros.trials.record.facts import (
    BEGUN,
    FACTS,
    ROW,
    SPARE,
    STACKS,
    recorded_stacks,
    stack_difference,
    this_stack,
)
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import write_tables

_UNFIT = re.compile(r'^[.-]|[^A-Za-z0-9_.-]')


def run_name(options: CampaignOptions, index: int, attempt: int = 1) -> str:
    """Name of a run and of its bag, valid for any program file name.

    On a standing graph it starts with the name of the campaign's folder, because all bags are
    written to one place; and each attempt at a broken run has its own name, so that late messages
    about one are not attributed to the next.
    """
    standing = options.standing_graph
    stem = options.out.name if standing else f'{_stem(options)}-s{options.seed}'
    name = f'{re.sub(_UNFIT, "_", stem)[:150]}-{index:05d}'
    return f'{name}.{attempt}' if attempt > 1 and standing else name


def run_request(
    options: CampaignOptions, index: int, scenario: Scenario, participants: Sequence[str],
    attempt: int = 1,
) -> RunRequest:
    """The request to the graph for run ``index`` of a campaign."""
    return RunRequest(
        run_id=run_name(options, index, attempt), index=index, program=_stem(options),
        seed=options.seed, scenario=scenario, judging=options.judging,
        participants=tuple(participants),
    )


def finished_row(options: CampaignOptions, request: RunRequest, result: RunResult) -> RunRow:
    """The row of a run that the graph has answered."""
    sim_s = step_stamp_ns(max(result.last_seq, 0), request.scenario.period_ns) / NS_PER_S
    perception = options.perception
    if not perception or is_node_elsewhere(perception):
        perception = result.perception or perception
    result = dataclasses.replace(result, timing=result.timing or options.timing.words)
    return RunRow.of_run(
        request, result, perception=perception, sim_s=sim_s,
        bag=_bag(options, request.run_id, result) if options.bags else '',
        stack=result.stack or this_stack(),
    )


def _bag(options: CampaignOptions, run_id: str, result: RunResult) -> str:
    """The bag of a run relative to the campaign's folder, or its path elsewhere, or ''."""
    if not options.standing_graph:
        # A verdict counts only if the recorder has closed the bag, wherever its folder is now.
        return run_id if result.outcome.judged or (options.out / run_id).is_dir() else ''
    # The recorder of a standing graph has a folder of its own, maybe on another machine.
    bag = Path(result.bags, run_id)
    if not result.bags or not bag.is_dir():
        return ''
    return run_id if bag.parent == options.out.resolve() else str(bag)


def rejected_row(options: CampaignOptions, index: int, detail: str) -> RunRow:
    """The row of a scene rejected by the program's requirements."""
    return RunRow(
        run_id=run_name(options, index), index=index, program=_stem(options), seed=options.seed,
        perception=options.perception, outcome=Outcome.REJECTED, detail=detail,
        stack=this_stack(),
    )


def _stem(options: CampaignOptions) -> str:
    return Path(options.program).stem


def rename_broken(folder: Path) -> None:
    """Rename ``folder``, if it exists, to the first free ``<folder>.broken-<n>``."""
    if not folder.exists():
        return
    number = 1
    while (aside := folder.with_name(f'{folder.name}.broken-{number}')).exists():
        number += 1
    folder.rename(aside)


_BEFORE_RUNS = frozenset({RECORD_NAME, f'{RECORD_NAME}-journal', 'logs'})
"""Names that a campaign's folder may contain before its first run."""


class CampaignBook:
    """The open record of one campaign; a context manager that writes the table at its end.

    Attributes:
        options: options of the campaign.
        facts: facts of the campaign, from :meth:`begin` on.
        earlier: what the record contained when it was opened; only within the ``with``.
        warning: one line if these were made on another machine or version, or ''.
        complete: whether it ended as it was asked to, with all its runs or by a rule, so that
            nothing of a repaired record is missing any more; set by its owner.
    """

    def __init__(
        self, options: CampaignOptions, participants: Sequence[str],
        on_row: Callable[[RunRow], None] = lambda row: None, *, resume: bool = False,
    ) -> None:
        """Create the book; nothing is written before the ``with``.

        Args:
            options: options of the campaign.
            participants: names of the nodes in every run.
            on_row: called with each new row once it is on disk; not with earlier ones.
            resume: continue the existing campaign.
        """
        self.facts: dict[str, Any] = {}
        self.earlier = CampaignContent()
        self.warning = ''
        self.complete = False
        self.options = options
        self._out = options.out
        self._participants = tuple(participants)
        self._on_row = on_row
        self._resume = resume
        self._begun = False
        self._facts_due = False
        self._attempts: Counter[int] = Counter()
        self._documents: set[tuple[str, str]] = set()

    def check_folder(self) -> None:
        """Check that the folder is new or contains a campaign to resume; nothing is changed.

        Raises:
            UsageError: it is neither.
        """
        if self._resume:
            check_resumable(self._out)
        else:
            check_new(self._out)

    def __enter__(self) -> Self:
        """Open the record; create it and the folder if there is nothing to resume.

        Raises:
            UsageError: the folder cannot be used, or another campaign writes to it.
        """
        self.check_folder()
        make_out(self._out)
        path = self._out / RECORD_NAME
        try:
            self._record = Record(path, as_text=AS_TEXT)
        except UsageError:
            if not (why := repair_record(path)):
                raise
            warn_once(f'{why}; add requirements of taxinet monitor --add that are lost again')
            self._record = Record(path, as_text=AS_TEXT)
        try:
            self.earlier = campaign_content(path, self._record.entries)
        except BaseException:
            self._record.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of the rows so far, even after an error, if the campaign had started.

        Raises:
            RecordError: it cannot be written, or the record has been moved.
        """
        try:
            if not self._begun:
                return
            with self._watched():
                if error is None:
                    self._end()
                self._record.check_in_place()
                added = self._record.entries.get(REQUIREMENT, {})
                write_tables(StoredRows(
                    self._record.path, map(int, self._record.keys(ROW)),
                    {name: values['intervals'] for name, values in added.items()},
                ), self._out, self.facts)
        except RecordError:
            if not isinstance(error, RecordError):  # else report the first error
                raise
        finally:
            self._record.close()

    def _end(self) -> None:
        """Record that the campaign ended in good order, and what a repaired record had lost."""
        self._write_due_facts()
        self._record.put_all([
            *self._lost_documents(), (END, '', len(self._record.keys(ROW))),
            (SPARE, FACTS, self.facts),
        ])
        if self.complete:
            repaired(self._record)

    def _lost_documents(self) -> Iterator[tuple[str, str, Any]]:
        """Entries of documents that earlier rows refer to and the record lacks, if known."""
        words = zip(*set(self.earlier.values(*CATALOGUES)), strict=True)
        for (key, catalogue), used in zip(CATALOGUES.items(), words, strict=False):
            for word in {*used} - {''}:
                try:
                    found = catalogue.find(word)
                except UsageError:
                    self.complete = False
                else:
                    yield from self._new_document(key, found)

    def begin(self, facts: Mapping[str, Any]) -> None:
        """Record the facts of the campaign, before its first run.

        On a resume, they are written only when something is added to the record: until then the
        caller may still reject the earlier runs.

        Raises:
            RecordError: they cannot be written.
        """
        before = self.earlier
        self.facts = {**facts, STACKS: {**recorded_stacks(before.facts), **facts[STACKS]}}
        self._attempts.update(before.attempts)
        self._documents.update(before.documents)
        if before.rows:
            self.warning = stack_difference(before.facts, str(self._out))
        self._facts_due = True
        if not before.rows:
            self._write_due_facts()
        self._begun = True

    def add_facts(self, facts: Mapping[str, Any]) -> None:
        """Record facts that have become known.

        Raises:
            RecordError: they cannot be written.
        """
        self.facts, self._facts_due = {**self.facts, **facts}, True
        self._write_due_facts()

    def add_machine(self, record: Provenance) -> None:
        """Record another machine, before the first of its runs.

        Args:
            record: its provenance, see :mod:`taxinet_ros.core.provenance`.

        Raises:
            RecordError: it cannot be written.
        """
        stack = stack_id(record)
        if stack not in self.facts[STACKS]:
            self.add_facts({STACKS: {**self.facts[STACKS], stack: dict(record)}})

    def begin_run(self, index: int, scenario: Scenario) -> RunRequest:
        """Record that a run is about to start; rename the files of an earlier attempt.

        Raises:
            RecordError: they cannot be written.
        """
        self._write_due_facts()
        self._attempts[index] += 1
        request = run_request(
            self.options, index, scenario, self._participants, self._attempts[index]
        )
        rename_broken(self._out / request.run_id)
        entries = [
            *(entry for key, catalogue in CATALOGUES.items()
              for entry in self._new_document(key, catalogue.find(getattr(scenario, key)))),
            (BEGUN, run_key(index), self._attempts[index]),
        ]
        with self._watched():
            self._record.put_all(entries)
        return request

    def keep(self, row: RunRow) -> None:
        """Record the result of a run.

        Raises:
            RecordError: it cannot be written.
        """
        row.check()
        self._attempts.pop(row.index, None)
        try:
            self._write_due_facts()
            with self._watched():
                self._record.put(ROW, run_key(row.index), row.to_json())
        finally:
            self._on_row(row)

    def _new_document(self, key: str, found: NamedDocument) -> Iterator[tuple[str, str, Any]]:
        """The entry of a document, unless it is shipped or recorded already."""
        if not found.shipped and (key, found.reference) not in self._documents:
            self._documents.add((key, found.reference))
            yield DOCUMENT, f'{key} {found.reference}', (key, found.document)

    def _write_due_facts(self) -> None:
        if not self._facts_due:
            return
        self._facts_due = False
        with self._watched():
            for kind in (END, SPARE):
                self._record.remove(kind)
            self._record.put(FACTS, '', self.facts)

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        """Context for writing, in which errors of the disk name the way out."""
        try:
            yield
        except OSError as error:
            where = error.filename or self._out
            raise RecordError(f'{where}: {disk_words(error)}; fix that and resume it') from error


def check_resumable(out: Path) -> None:
    """Check that ``out`` contains a campaign to resume, possibly without runs.

    Raises:
        UsageError: there is none.
    """
    path = out / RECORD_NAME
    if path.is_file() and path.stat().st_size:
        return
    there = {entry.name for entry in out.iterdir()} if out.is_dir() else set()
    if not there:
        raise UsageError(
            f'resume: {path}: no such file, so there is nothing to resume; leave resume out'
        )
    if not there <= _BEFORE_RUNS:
        what = 'is empty' if path.is_file() else 'no such file'
        raise UsageError(
            f'resume: {path}: {what}, so the earlier options are unknown; put it back, or '
            'choose another folder'
        )
