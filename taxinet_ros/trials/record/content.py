"""Content of a campaign's record: facts, runs, and which of them have no result yet."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.core.scenario_fields import CATALOGUES
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, Entries, read_record, read_texts
from taxinet_ros.trials.record.facts import BEGUN, FACTS, ROW, SPARE
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.rows import Intervals, RecordedRows, RowsByIndex, values_of

REQUIREMENT, DOCUMENT, END = 'requirement', 'document', 'end'
"""Kinds of entries: a formula evaluated afterwards, a document that is not shipped, and that the
campaign ended in good order after the last result."""

AS_TEXT = frozenset({BEGUN, ROW})
"""Kinds of which there is one a run, and that are read later (:mod:`.rows`)."""

FEW = 1000
"""Number of rows up to which all are made at once, so that what is wrong is named at once, and of
rows of an open campaign that are in memory at once."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CampaignContent:
    """Content of a campaign's record.

    Attributes:
        facts: see :mod:`.facts`; empty if not yet written.
        rows: the result of each run, by index; many are read as they are asked for.
        attempts: number of starts of each run, by index.
        added: formulas evaluated afterwards, by name; the rows contain their values.
        finished: whether the campaign ended in good order after the last result.
        documents: scenario key and reference of each document that it has in full.
    """

    facts: Mapping[str, Any] = field(default_factory=dict)
    rows: Sequence[RunRow] = ()
    attempts: Mapping[int, int] = field(default_factory=dict)
    added: Mapping[str, str] = field(default_factory=dict)
    finished: bool = False
    documents: frozenset[tuple[str, str]] = frozenset()

    @property
    def unfinished(self) -> tuple[int, ...]:
        """Indices of runs that were started and have no result, ascending."""
        return tuple(sorted(self.attempts.keys() - self.by_index.keys()))

    @property
    def by_index(self) -> Mapping[int, RunRow]:
        """The rows by index."""
        return RowsByIndex(self.rows, {index: at for at, index in enumerate(self._indices)})

    def only(self, wanted: Set[int]) -> Mapping[int, RunRow]:
        """The rows of some indices, by index."""
        return RowsByIndex(self.rows, {
            index: at for at, index in enumerate(self._indices) if index in wanted
        })

    @property
    def _indices(self) -> Iterable[int]:
        rows = self.rows
        return rows.indices if isinstance(rows, RecordedRows) else [row.index for row in rows]

    def values(self, *names: str) -> Iterator[tuple[Any, ...]]:
        """Some attributes of each row, by index, without making the rows if they are many."""
        return values_of(self.rows, *names)

    @property
    def begun(self) -> int:
        """Number of runs that were started or have a result, counted from run 0."""
        return 1 + max((*self.unfinished, *self._indices), default=-1)


def read_campaign(folder: Path) -> CampaignContent:
    """Read the record of a campaign, even while it is being written.

    Raises:
        UsageError: there is none, or it is damaged.
    """
    path = folder / RECORD_NAME
    return campaign_content(path, read_record(path, AS_TEXT))


def campaign_content(path: Path, entries: Entries) -> CampaignContent:
    """Content of the entries of a record.

    Args:
        path: path of the record, for messages.
        entries: the entries, with :data:`AS_TEXT`.

    Raises:
        UsageError: an entry is not one of this version.
    """
    facts = entries.get(FACTS, {}) or entries.get(SPARE, {})
    try:
        documents = frozenset(
            # Finding it makes it known, so that references in rows can be resolved.
            (key, CATALOGUES[key].find(document).reference)
            for key, document in entries.get(DOCUMENT, {}).values()
        )
        added = entries.get(REQUIREMENT, {})
        rows = RecordedRows(path, entries.get(ROW, {}), {
            name: values['intervals'] for name, values in added.items()
        })
        return CampaignContent(
            facts=next(iter(facts.values()), {}), rows=tuple(rows) if len(rows) <= FEW else rows,
            attempts={int(key): int(attempts) for key, attempts in entries.get(BEGUN, {}).items()},
            added={name: values['formula'] for name, values in added.items()},
            finished=END in entries, documents=documents,
        )
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise UsageError(f'{path}: not a record of this version ({error})') from error


def run_key(index: int) -> str:
    """Key of a run's entries; as text, keys are in the order of the indices."""
    return f'{index:09d}'


class StoredRows:
    """The rows of an open campaign in the order of their ends, most of them in its record only.

    Attributes:
        latest: the last thousand or so, as the record may be lost.
    """

    def __init__(self, path: Path, indices: Iterable[int], added: Intervals) -> None:
        """Nothing is read yet.

        Args:
            path: path of the record.
            indices: those of rows that it has.
            added: see :data:`Intervals`.
        """
        self.latest: list[RunRow] = []
        self._path, self._added = path, added
        self._indices = array('q', indices)

    def append(self, row: RunRow) -> None:
        """Add a row, which is in the record before a thousand others are added."""
        self._indices.append(row.index)
        self.latest.append(row)
        if len(self.latest) > 2 * FEW:
            del self.latest[:FEW]

    def parts(self) -> Iterator[Sequence[RunRow]]:
        """The rows in parts, of which one at a time is in memory."""
        older, latest = len(self) - len(self.latest), self.latest[:]
        for at in range(0, older, FEW):
            yield self._read(self._indices[at:min(at + FEW, older)])
        if latest:
            yield latest

    def __iter__(self) -> Iterator[RunRow]:
        for part in self.parts():
            yield from part

    def __len__(self) -> int:
        return len(self._indices)

    def _read(self, indices: Iterable[int]) -> RecordedRows:
        texts = read_texts(self._path, ROW, map(run_key, indices))
        return RecordedRows(self._path, texts, self._added)
