"""How commands show lines: as they are, whole and without markup."""

from __future__ import annotations

from rich.console import Console


def line_console(*, stderr: bool = False, quiet: bool = False) -> Console:
    """Console whose lines are neither wrapped nor read as markup; tables need ``soft_wrap=False``.

    Args:
        stderr: print to standard error, as all does that is no result of a command with ``--json``.
        quiet: print nothing.
    """
    return Console(highlight=False, markup=False, soft_wrap=True, stderr=stderr, quiet=quiet)
