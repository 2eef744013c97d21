"""``taxinet check-node``: test a user's node or function against the contract, clause by clause."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import sys
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
        str | None,
        typer.Argument(
            metavar='COMMAND',
            help="command that starts your node, e.g. 'ros2 run my_pkg my_node'; or FILE.py:NAME",
        ),
    ] = None,
    role: Annotated[
        str | None,
        typer.Option(
            metavar='ROLE',
            help='perception or controller (default: detected; --external needs it)',
        ),
    ] = None,
    external: Annotated[
        bool, typer.Option('--external', help='you start the node yourself, without COMMAND')
    ] = False,
    domain: Annotated[
        int | None, typer.Option(min=0, max=232, help='ROS domain (default: a free one)')
    ] = None,
    frames: Annotated[
        int, typer.Option(min=8, max=500, help='number of messages in a run')
    ] = 24,
    patience: Annotated[
        float,
        typer.Option(
            min=0.1, max=3600.0, metavar='SECONDS',
            help='timeout for an answer; three times as long for READY',
        ),
    ] = 10.0,
    log: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.log', writable=True, dir_okay=False, help="file for the node's output"
        ),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Test your own node against the lockstep protocol.

    The kit simulates all other nodes: several runs of a few frames, a malformed message, SIGINT and
        SIGTERM. It prints one line per clause of the contract in docs/own_nodes.md: PASS, FAIL with
        the expected and actual behaviour and a fix, or not tried. Exit code: 0 no clause broken, 2
        some clause broken.
    """
    from taxinet_ros.testing import check_function
    from taxinet_ros.testing.clauses import ROLES

    if external:
        refuse_given(context, ('log',), 'the output of a node that you start is not seen here')
    if role is not None and role not in ROLES:
        raise UsageError(f'--role {role}: unknown; known: {", ".join(ROLES)}')
    if (command is None) is not external:
        raise UsageError(
            'check-node: name a COMMAND, or give --external for a node you start yourself'
        )
    if external and role is None:
        raise UsageError('--role: with --external, give perception or controller')
    words = _program(command)
    if command is not None and words is None:
        if role is None:
            raise UsageError(f'--role: {command} is a function; give perception or controller')
        unused = ('domain', 'frames', 'patience', 'log')
        refuse_given(context, unused, f'{command} is a function, which is called without a graph')
        found = check_function(role, command)
    else:
        role, found = _drive(words, role, domain, frames, patience, log)
    broken = [one.clause for one in found if one.broken]
    if as_json:
        clauses = [dataclasses.asdict(one) for one in found]
        print(json.dumps({'role': role, 'kept': not broken, 'clauses': clauses}, indent=2))
    else:
        print(_words(role, found), flush=True)
    if broken:
        raise UsageError(f'check-node: the {role} breaks: {", ".join(broken)}')
    return ExitCode.OK


def _program(command: str | None) -> list[str] | None:
    """Program and arguments of a node; None for a function, or if somebody else starts the node."""
    from taxinet_ros.core.user_code import COMMAND, command_of, names_user_code

    words = command_of(f'{COMMAND}{command}') if command is not None else None
    if not words or command is None:
        return None
    if len(words) == 1 and names_user_code(command) and not os.access(command, os.X_OK):
        if command.endswith('.py'):
            raise UsageError(
                f"check-node: {command}: give 'python3 {command}' for a node, {command}:NAME for "
                "a function"
            )
        return None
    if shutil.which(words[0]) is None:
        raise UsageError(f'check-node: {words[0]}: no such program')
    return words


def _drive(
    words: list[str] | None, role: str | None, domain: int | None, frames: int, patience_s: float,
    log: Path | None,
) -> tuple[str, list[Finding]]:
    """Drive a node, whose output goes to a file."""
    from taxinet_ros.testing.stage import check_node

    with tempfile.NamedTemporaryFile(prefix='taxinet-', suffix='.log') as scratch:
        if log is not None:
            try:
                log.write_bytes(b'')
            except OSError as error:
                raise UsageError(f'--log {log}: {error.strerror}') from error
        return check_node(
            words, role, log=log or Path(scratch.name),
            say=lambda line: print(line, file=sys.stderr, flush=True), domain_id=domain,
            frames=frames, patience_s=patience_s,
        )


def _words(role: str, found: list[Finding]) -> str:
    """A line or more for each clause, those not tried by the reason, and how many of each."""
    from taxinet_ros.testing.clauses import Status

    left: dict[str, list[str]] = {}
    lines = []
    for one in found:
        if one.status is Status.NOT_TRIED:
            left.setdefault(one.came, []).append(one.clause)
        else:
            lines.append(_wrapped(f'{one.status:<9} {one.clause:<{_NAME_WIDTH}} ', one.words))
    lines += [_wrapped('not tried ', f'{", ".join(names)}: {why}') for why, names in left.items()]
    count = Counter(one.status for one in found)
    return '\n'.join([
        *lines, f'{role}: {count[Status.PASS]} kept, {count[Status.FAIL]} broken, '
        f'{count[Status.NOT_TRIED]} not tried',
    ])


def _wrapped(head: str, text: str) -> str:
    return textwrap.fill(
        text, _LINE_WIDTH, initial_indent=head, subsequent_indent=' ' * len(head),
        break_long_words=False, break_on_hyphens=False,
    )
