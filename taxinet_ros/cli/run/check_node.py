"""``taxinet check-node``: test a user's node or function against the contract, clause by clause."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import tempfile
import textwrap
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import JsonOption, refuse_given
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.testing.clauses import Finding

_NAME_WIDTH, _LINE_WIDTH = 14, 100


def check_node(
    context: typer.Context,
    command: Annotated[
        str,
        typer.Argument(
            metavar='COMMAND',
            help="command that starts your node, e.g. 'ros2 run my_pkg my_node'; or FILE.py:NAME",
        ),
    ],
    role: Annotated[
        str | None,
        typer.Option(
            metavar='ROLE',
            help='perception or controller (default: detected; a function needs it)',
        ),
    ] = None,
    patience: Annotated[
        float,
        typer.Option(
            min=0.1, max=3600.0, metavar='SECONDS',
            help='timeout for an answer; three times as long for READY',
        ),
    ] = 10.0,
    as_json: JsonOption = False,
) -> int:
    """Test your own node against the lockstep protocol.

    The kit simulates all other nodes: several runs of a few frames, a malformed message, SIGINT and
    SIGTERM. It prints one line per clause of the contract in docs/own_nodes.md: PASS, FAIL with the
    expected and actual behaviour and a fix, or not tried. Exit code: 0 no clause broken, 2 some
    clause broken.
    """
    from taxinet_ros.testing import check_function
    from taxinet_ros.testing.clauses import ROLES

    if role is not None and role not in ROLES:
        raise UsageError(f'--role {role}: unknown; known: {", ".join(ROLES)}')
    if words := _program(command):
        role, found = _drive(words, role, patience)
    else:
        if role is None:
            raise UsageError(f'--role: {command} is a function; give perception or controller')
        why = f'{command} is a function, which is called without a graph'
        refuse_given(context, ('patience',), why)
        found = check_function(role, command)
    broken = [one.clause for one in found if one.broken]
    if as_json:
        clauses = [dataclasses.asdict(one) for one in found]
        print(json.dumps({'role': role, 'kept': not broken, 'clauses': clauses}, indent=2))
    else:
        print(_words(role, found), flush=True)
    if broken:
        raise UsageError(f'check-node: the {role} breaks: {", ".join(broken)}')
    return ExitCode.OK


def _program(command: str) -> list[str]:
    """Program and arguments of a node; empty for a function."""
    from taxinet_ros.core.user_code import COMMAND, command_of, names_user_code

    words = command_of(COMMAND + command) or []
    if len(words) == 1 and names_user_code(command) and not os.access(command, os.X_OK):
        if command.endswith('.py'):
            raise UsageError(
                f"check-node: {command}: give 'python3 {command}' for a node, {command}:NAME for "
                "a function"
            )
        return []
    if shutil.which(words[0]) is None:
        raise UsageError(f'check-node: {words[0]}: no such program')
    return words


def _drive(
    words: list[str], role: str | None, patience_s: float
) -> tuple[str, list[Finding]]:
    """Drive a node, whose output goes to a file that findings quote."""
    from taxinet_ros.testing.stage import check_node

    with tempfile.NamedTemporaryFile(prefix='taxinet-', suffix='.log') as log:
        return check_node(words, role, log=Path(log.name), patience_s=patience_s)


def _words(role: str, found: list[Finding]) -> str:
    """A paragraph for each clause, and how many are kept."""
    heads = [f'{one.status:<9} {one.clause:<{_NAME_WIDTH}} ' for one in found]
    count = Counter(str(one.status) for one in found)
    return '\n'.join([
        *(textwrap.fill(
            one.words, _LINE_WIDTH, initial_indent=head, subsequent_indent=' ' * len(head),
            break_long_words=False, break_on_hyphens=False,
        ) for head, one in zip(heads, found, strict=True)),
        f'{role}: {count["PASS"]} kept, {count["FAIL"]} broken, {count["not tried"]} not tried',
    ])
