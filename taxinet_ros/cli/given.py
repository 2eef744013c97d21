"""Which options somebody has typed, as against those that have their default."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import typer

from taxinet_ros.core.errors import UsageError


def given_options(context: typer.Context) -> dict[str, Any]:
    """The parameters of a command that its command line sets, by name."""
    return {
        name: value for name, value in context.params.items()
        if getattr(context.get_parameter_source(name), 'name', '') == 'COMMANDLINE'
    }


def asks_for(word: str, words: Sequence[str], given: Collection[str]) -> bool:
    """Whether the words after ``taxinet bench`` ask for a study of the samplers.

    Args:
        word: that asks for it.
        words: the subjects.
        given: names of the parameters that the command line sets.

    Raises:
        UsageError: the word is not the first, or options do not belong to it.
    """
    if word not in words:
        return False
    if words[0] != word:
        raise UsageError(f'bench: {word} goes first, and what it is to study after it')
    wrong = set(given) - {'repeats', 'as_json', 'subjects'}
    if wrong:
        raise UsageError(f'bench: --{min(wrong)}: not with {word}')
    return True
