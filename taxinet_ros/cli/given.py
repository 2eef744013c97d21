"""Which options somebody has typed, as against those that have their default."""

from __future__ import annotations

from typing import Any

import typer


def given_options(context: typer.Context) -> dict[str, Any]:
    """The parameters of a command that its command line sets, by name."""
    return {
        name: value for name, value in context.params.items()
        if getattr(context.get_parameter_source(name), 'name', '') == 'COMMANDLINE'
    }
