"""Which options somebody has typed, as against those that have their default."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import typer

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.node_words import COMMAND


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


def word_of(context: typer.Context, role: str) -> str:
    """Who plays a role in the graph: the word of its option, or of the command for it.

    Args:
        context: of a command that has the options ``--ROLE`` and ``--ROLE-cmd``.
        role: ``perception`` or ``controller``.

    Raises:
        UsageError: both are given.
    """
    command = context.params[f'{role}_cmd']
    if command is None:
        return str(context.params[role])
    if role in given_options(context):
        raise UsageError(f'--{role}: not with --{role}-cmd, which says who it is; leave one out')
    return f'{COMMAND}{command}'
