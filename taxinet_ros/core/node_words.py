"""Words for a part of the loop that is a node of somebody's own, in whatever language.

``external``: a node that is started elsewhere. ``cmd:COMMAND``: one that we start, look after and
end, as in ``cmd:ros2 run my_pkg my_node``.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from taxinet_ros.core.errors import UsageError

EXTERNAL: Final = 'external'
COMMAND: Final = 'cmd:'

NO_NODE_HERE: Final = (
    'is a node in a graph, and this needs none; name something that can be called here: a word, '
    'a file, or FILE.py:NAME'
)


def is_node_elsewhere(word: str) -> bool:
    """Whether a word means a node that is not one of ours."""
    return word == EXTERNAL or word.startswith(COMMAND)


def command_of(word: str) -> list[str] | None:
    """Program and arguments of a ``cmd:`` word, split as a shell does; None for another word.

    Raises:
        UsageError: there is no program in it, or a quote without its end.
    """
    if not word.startswith(COMMAND):
        return None
    try:
        words = shlex.split(word.removeprefix(COMMAND))
    except ValueError as error:
        raise UsageError(f'{word}: {error}') from error
    if not words:
        raise UsageError(f"{word!r}: names no program, as in {COMMAND}'ros2 run my_pkg my_node'")
    return words


def node_command(word: str, name: str, remaps: Sequence[str] = ()) -> list[str] | None:
    """The same, with the arguments that give the node the name that a graph knows it by.

    Args:
        word: as of :func:`command_of`.
        name: of the node.
        remaps: further remap rules, ``FROM:=TO``.

    Raises:
        UsageError: as there.
    """
    words = command_of(word)
    if words is None:
        return None
    rules = [part for rule in (f'__node:={name}', *remaps) for part in ('-r', rule)]
    return [*words, '--ros-args', *rules]


def short_word(word: str) -> str:
    """What names of folders hold of a word: a file's stem, and of a command that it is one."""
    if word.startswith(COMMAND):
        return COMMAND.removesuffix(':')
    return Path(word.partition('.py:')[0]).stem if '.py:' in word else Path(word).stem
