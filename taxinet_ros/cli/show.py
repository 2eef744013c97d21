"""How commands show lines: as they are, whole and without markup."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

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


def print_table(
    console: Console, headings: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1
) -> None:
    """Print a table whose first columns, so many, are aligned left, the others right."""
    table = Table(box=None, pad_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify='left' if number < left else 'right', no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console.print(table, soft_wrap=False)
