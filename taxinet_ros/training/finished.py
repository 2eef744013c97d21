"""Which images of a dataset are done: JSON lines, one appended for each, read when it goes on."""

from __future__ import annotations

import fcntl
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

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


class FinishedImages:
    """The open record: one writer at a time; a context manager."""

    def __init__(self, path: Path) -> None:
        """Open ``path`` to append, making it if need be; a torn last line is cut off.

        Raises:
            UsageError: it cannot be opened, is no such record, or another command writes to it.
        """
        self._path = path
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise UsageError(f'dataset: {path}: {error.strerror}') from error
        try:
            self.rows = self._read()
        except BaseException:
            os.close(self._fd)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.close(self._fd)

    def add(self, row: FinishedImage) -> None:
        """Record that an image is in its place.

        Raises:
            OSError: the line could not be written whole, as on a full disk.
        """
        line = json.dumps(asdict(row), separators=(',', ':')).encode() + b'\n'
        if (written := os.write(self._fd, line)) != len(line):
            raise OSError(None, f'only {written} of {len(line)} bytes fitted')
        self.rows[row.index] = row

    def _read(self) -> dict[int, FinishedImage]:
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            folder = self._path.parent
            raise UsageError(f'dataset: {folder}: another command is writing to it') from error
        data = self._path.read_bytes()
        whole = data[: data.rfind(b'\n') + 1]
        os.ftruncate(self._fd, len(whole))
        try:
            rows = [FinishedImage(**json.loads(line)) for line in whole.splitlines()]
        except (ValueError, TypeError) as error:
            raise UsageError(
                f'dataset: {self._path}: damaged; delete it, and every image is rendered and '
                'compared again'
            ) from error
        return {row.index: row for row in rows}
