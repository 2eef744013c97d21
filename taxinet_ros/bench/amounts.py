"""What is no time: bytes on disk and in memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

Amounts = dict[str, Callable[[], float]]
"""What tells an amount [bytes] once all is measured, by name; NaN where there is none."""


def folder_bytes(folder: Path) -> int:
    """Size of all the files in a folder [bytes]."""
    return sum(file.stat().st_size for file in folder.rglob('*') if file.is_file())
