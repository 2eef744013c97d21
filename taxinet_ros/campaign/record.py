"""What a campaign leaves on disk, kept in step: what was asked, the ledger, and the table.

While it is open its files are watched: what was moved, deleted or replaced under a campaign ends
it, for nobody would find its verdicts where it says that they are.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from taxinet_ros.bag.layout import disk_words
from taxinet_ros.campaign.facts import FACTS_NAME, LEDGER_NAME, write_facts
from taxinet_ros.campaign.ledger import Ledger
from taxinet_ros.campaign.options import check_new, make_out
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.table import write_tables
from taxinet_ros.core.errors import RecordError, UsageError

_OF_NO_RUN = frozenset({FACTS_NAME, f'{FACTS_NAME}.tmp', LEDGER_NAME, 'logs'})
"""What may lie in a campaign's folder before its first run."""


class Record:
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
    if not there <= _OF_NO_RUN:
        raise UsageError(
            f'--resume: {path}: no such file, and without it nobody knows what was run; put it '
            'back, or name another --out'
        )
