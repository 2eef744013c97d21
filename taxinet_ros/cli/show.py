"""How commands show lines: as they are, whole and without markup."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from taxinet_ros.files.plain_values import json_text


def print_json(values: Any) -> None:
    """Print a result as a JSON document, which is all that its command prints there."""
    print(json_text(values))


def line_console(
    *, stderr: bool = False, quiet: bool = False, width: int | None = None
) -> Console:
    """Console whose lines are neither wrapped nor read as markup; tables need ``soft_wrap=False``.

    Args:
        stderr: print to standard error, as all does that is no result of a command with ``--json``.
        quiet: print nothing.
        width: of tables where it is no terminal.
    """
    console = Console(emoji=False, highlight=False, markup=False, soft_wrap=True, stderr=stderr,
                      quiet=quiet)
    if width is not None and not console.is_terminal:
        console.width = width
    return console
