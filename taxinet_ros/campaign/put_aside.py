"""Keeps what a broken run left behind, out of the way of the run that replaces it."""

from __future__ import annotations

from pathlib import Path


def put_aside(folder: Path) -> None:
    """Rename ``folder``, if there is one, to the first free ``<folder>.broken-<n>``."""
    if not folder.exists():
        return
    number = 1
    while (aside := folder.with_name(f'{folder.name}.broken-{number}')).exists():
        number += 1
    folder.rename(aside)
