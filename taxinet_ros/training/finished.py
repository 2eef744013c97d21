"""Which images of a dataset are done: JSON lines, one appended for each, read when it goes on."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from taxinet_ros.campaign.journal import Journal, JournalOwner, damaged_line
from taxinet_ros.campaign.plain_kinds import check_kind
from taxinet_ros.core.errors import UsageError


@dataclass(frozen=True, kw_only=True, slots=True)
class FinishedImage:
    """An image that lies in the folder.

    Attributes:
        index: its number.
        cte_m, he_rad: true errors [m], [rad].
        sha256: digest of its file.
    """

    index: int
    cte_m: float
    he_rad: float
    sha256: str


class FinishedImages(JournalOwner):
    """The open record: one writer at a time; a context manager."""

    def __init__(self, path: Path) -> None:
        """Open ``path`` to append, making it if need be; a torn last line is cut off.

        Raises:
            UsageError: it cannot be opened, is no such record, or another command writes to it.
        """
        self._path = path
        try:
            self._journal = Journal(path)
        except BlockingIOError as error:
            raise UsageError(f'dataset: {path.parent}: another command is writing to it') from error
        except OSError as error:
            raise UsageError(f'dataset: {path}: {error.strerror}') from error
        try:
            self.rows = self._read()
        except BaseException:
            self._journal.close()
            raise

    def add(self, row: FinishedImage) -> None:
        """Record that an image is in its place.

        Raises:
            OSError: the line could not be written whole, as on a full disk.
        """
        self._journal.append(asdict(row))
        self.rows[row.index] = row

    def _read(self) -> dict[int, FinishedImage]:
        rows = {}
        for number, event in enumerate(self._journal.events, start=1):
            try:
                row = FinishedImage(**event)
                for name, kind in FinishedImage.__annotations__.items():
                    check_kind(name, kind, getattr(row, name))
            except (TypeError, ValueError) as error:
                raise damaged_line(self._path, number, str(error)) from error
            rows[row.index] = row
        return rows
