"""What a campaign leaves on disk, kept in step: what was asked, the ledger, and the table.

While the book is open its files are watched: what was moved, deleted or replaced under a
campaign ends it, for nobody would find its verdicts where it says that they are. Numbers, names
and rows of runs are the same for a plain campaign, a search and a shrinking.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from taxinet_ros.campaign.options import CampaignOptions, check_new, make_out
from taxinet_ros.campaign.record.facts import FACTS_NAME, LEDGER_NAME, this_stack, write_facts
from taxinet_ros.campaign.record.ledger import Ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import write_tables
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.user_code import is_node_elsewhere
from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import disk_words, draft_path

_UNFIT = re.compile(r'^[.-]|[^A-Za-z0-9_.-]')


def run_name(options: CampaignOptions, index: int, attempt: int = 1) -> str:
    """Name of a run, and of its bag, whatever the program's file is called.

    On a graph that outlives the campaign it begins with the name of the campaign's folder, which no
    other one has, for all their bags are written to one place; and each attempt at a broken run
    has a name of its own, so that what a node still says of one is not taken for the next.
    """
    standing = options.standing_graph
    stem = options.out.name if standing else f'{_stem(options)}-s{options.seed}'
    name = f'{re.sub(_UNFIT, "_", stem)[:150]}-{index:05d}'
    return f'{name}.{attempt}' if attempt > 1 and standing else name


def run_request(
    options: CampaignOptions, index: int, scenario: Scenario, participants: Sequence[str]
) -> RunRequest:
    """What run ``index`` of a campaign asks of the graph."""
    return RunRequest(
        run_id=run_name(options, index), index=index, program=_stem(options), seed=options.seed,
        scenario=scenario, specs=options.specs, participants=tuple(participants),
        stop_on=options.stop_on, bounds=options.bounds, rates=options.rates,
    )


def finished_row(options: CampaignOptions, request: RunRequest, result: RunResult) -> RunRow:
    """The row of a run that the graph has answered."""
    # A verdict stands only where the recorder has closed the bag, wherever its folder is by now.
    recorded = result.outcome.judged or (options.out / request.run_id).is_dir()
    bag = request.run_id if recorded else ''
    sim_s = max(result.last_seq, 0) * CONTROL_PERIOD_NS / NS_PER_S
    perception = options.perception
    if not perception or is_node_elsewhere(perception):
        perception = result.perception or perception
    result = dataclasses.replace(result, timing=result.timing or options.timing.words)
    return RunRow.of_run(
        request, result, perception=perception, sim_s=sim_s, bag=bag, stack=this_stack()
    )


def rejected_row(options: CampaignOptions, index: int, detail: str) -> RunRow:
    """The row of a scene that the program's requirements refuse."""
    return RunRow(
        run_id=run_name(options, index), index=index, program=_stem(options), seed=options.seed,
        perception=options.perception, outcome=Outcome.REJECTED, detail=detail,
        stack=this_stack(),
    )


def _stem(options: CampaignOptions) -> str:
    return Path(options.program).stem


def rename_broken(folder: Path) -> None:
    """Rename ``folder``, if there is one, to the first free ``<folder>.broken-<n>``."""
    if not folder.exists():
        return
    number = 1
    while (aside := folder.with_name(f'{folder.name}.broken-{number}')).exists():
        number += 1
    folder.rename(aside)


_NOT_OF_A_RUN = frozenset({FACTS_NAME, draft_path(Path(FACTS_NAME)).name, LEDGER_NAME, 'logs'})
"""What may lie in a campaign's folder before its first run."""


class CampaignBook:
    """The open record of one campaign; a context manager that writes the table at its end.

    Attributes:
        rows: the newest row of each run by its index, as the table has them; a campaign that is
            resumed puts in those of before.
    """

    def __init__(self, out: Path, specs: Sequence[str], *, resume: bool = False) -> None:
        """Open the ledger in the folder ``out``, making both where there is nothing to resume.

        Args:
            out: the campaign's folder.
            specs: names of its formulas, the headline first.
            resume: go on with what is there.

        Raises:
            UsageError: the folder cannot be used, or another campaign writes to it.
        """
        self.rows: dict[int, RunRow] = {}
        self._out = out
        self._specs = tuple(specs)
        if not resume:
            check_new(out)
        make_out(out)
        self._ledger = Ledger(out / LEDGER_NAME)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of what there is, whatever happened.

        Raises:
            RecordError: it cannot be written, or the record is not in its place any more.
        """
        try:
            with self._kept():
                self._check_in_place()
                write_tables(self.rows.values(), self._out, self._specs)
        except RecordError:
            if not isinstance(error, RecordError):  # else the first trouble is the one to tell
                raise
        finally:
            self.close()

    def close(self) -> None:
        """Let others open it; no table is written."""
        self._ledger.close()

    def facts(self, facts: Mapping[str, Any]) -> None:
        """Put down what the campaign is.

        Raises:
            RecordError: that is not possible.
        """
        with self._kept():
            self._ledger.campaign(facts)  # first: what campaign.json says, the ledger has said
            write_facts(self._out, facts)

    def intent(self, index: int, run_id: str, scenario_sha256: str = '') -> None:
        """Put down that a run is about to begin.

        Raises:
            RecordError: that is not possible.
        """
        with self._kept():
            self._ledger.intent(index, run_id, scenario_sha256)

    def result(self, row: RunRow) -> None:
        """Put down how a run ended.

        Raises:
            RecordError: that is not possible; ``rows`` has it all the same.
        """
        self.rows[row.index] = row
        with self._kept():
            self._ledger.result(row)

    @contextlib.contextmanager
    def _kept(self) -> Iterator[None]:
        """Within the ``with`` something is written; afterwards the record is seen to be there."""
        try:
            yield
        except OSError as error:
            where = error.filename or self._out
            raise RecordError(f'{where}: {disk_words(error)}; --resume goes on') from error
        self._check_in_place()

    def _check_in_place(self) -> None:
        self._ledger.check_in_place()
        if not (self._out / FACTS_NAME).is_file():
            raise RecordError(
                f'{self._out / FACTS_NAME}: was moved or deleted while the campaign was under way'
            )


def check_resumable(out: Path) -> None:
    """See that there is a campaign in ``out`` to be continued, if one of no runs so far.

    Raises:
        UsageError: there is none.
    """
    path = out / LEDGER_NAME
    if path.is_file():
        return
    there = {entry.name for entry in out.iterdir()} if out.is_dir() else set()
    if not there:
        raise UsageError(
            f'--resume: {path}: no such file, so nothing was begun; leave --resume out'
        )
    if not there <= _NOT_OF_A_RUN:
        raise UsageError(
            f'--resume: {path}: no such file, and without it nobody knows what was run; put it '
            'back, or name another --out'
        )
