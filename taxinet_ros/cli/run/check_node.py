"""``taxinet check-node``: test a user's node against the lockstep contract."""

from __future__ import annotations

import functools
import json
import math
import os
import shutil
import sys
import tempfile
import textwrap
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from taxinet_ros.cli.options import JsonOption, refuse_given
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.nodes.graph.node_process import NodeProcess
    from taxinet_ros.nodes.node_check import Finding, Report, Role, Starter

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
    if external:
        refuse_given(context, ('log',), 'the output of a node that you start is not seen here')
    return run_check(
        command, role=role, external=external, domain=domain, frames=frames, patience_s=patience,
        log=log, as_json=as_json,
    )


def run_check(
    command: str | None, *, role: str | None, external: bool, domain: int | None, frames: int,
    patience_s: float, log: Path | None, as_json: bool,
) -> int:
    """Drive a node and print which clauses it keeps and breaks.

    Returns:
        Exit code: 0, it keeps all clauses tried.

    Raises:
        UsageError: it breaks a clause, or an option is invalid.
    """
    from taxinet_ros.nodes.node_check import ROLES, check_node

    if role is not None and role not in ROLES:
        raise UsageError(f'--role {role}: unknown; known: {", ".join(ROLES)}')
    if (command is None) is not external:
        raise UsageError(
            'check-node: name a COMMAND, or give --external for a node you start yourself'
        )
    if external and role is None:
        raise UsageError('--role: with --external, give perception or controller')
    if not math.isfinite(patience_s):
        raise UsageError(f'--patience {patience_s:g}: not a number of seconds')
    if log is not None:
        _check_log(log)
    with tempfile.TemporaryDirectory(prefix='taxinet-') as scratch:
        printed = Path(scratch) / 'node.log'
        printed.touch()
        report = check_node(
            None if command is None else _starter(command, role, Path(scratch)), role, _say,
            domain_id=domain, frames=frames, patience_s=patience_s, log=printed,
        )
        print(_json(report) if as_json else _words(report), flush=True)
        if log is not None:
            shutil.copyfile(printed, log)
    if report.broken:
        raise UsageError(f'check-node: the {report.role.word} breaks: {", ".join(report.broken)}')
    return ExitCode.OK


def _check_log(log: Path) -> None:
    """Check that the log can be written, before the node is tested for a minute."""
    if log.is_dir():
        raise UsageError(f'--log {log}: is a folder; name a file')
    if not log.parent.is_dir():
        raise UsageError(f'--log {log}: no such folder: {log.parent}')
    if not os.access(log if log.exists() else log.parent, os.W_OK):
        raise UsageError(f'--log {log}: cannot be written')


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _starter(command: str, role: str | None, scratch: Path) -> Starter:
    from taxinet_ros.core.motion.controller import check_controller
    from taxinet_ros.core.perception.perception import check_perception
    from taxinet_ros.core.user_code import COMMAND, command_of, names_user_code
    from taxinet_ros.nodes.node_check import command_starter
    from taxinet_ros.nodes.steering_controller import SteeringController
    from taxinet_ros.nodes.taxinet_perception import TaxinetPerception

    words = command_of(COMMAND + command) or []
    program = len(words) == 1 and os.access(words[0], os.X_OK) and Path(words[0]).is_file()
    if len(words) > 1 or program or not names_user_code(command):
        if shutil.which(words[0]) is None:
            raise UsageError(f'check-node: {words[0]}: no such program')
        return command_starter(words)
    if command.endswith('.py'):
        raise UsageError(
            f"check-node: {command}: give 'python3 {command}' for a node, {command}:NAME for a "
            "function"
        )
    if role is None:
        raise UsageError(f'--role: {command} is a function; give perception or controller')
    if role == 'perception':
        check_perception(command)
        return functools.partial(_start_ours, TaxinetPerception, {'weights': command}, scratch)
    check_controller(command)
    return functools.partial(_start_ours, SteeringController, {'controller': command}, scratch)


def _start_ours(
    kind: type[Any], parameters: dict[str, Any], scratch: Path, role: Role, domain: int, log: Path
) -> NodeProcess:
    """Start the shipped node with the user's function."""
    from taxinet_ros.nodes.graph.node_process import NodeProcess

    return NodeProcess.of_ours(
        role.node, kind, parameters, domain=domain, log=log, scratch=scratch,
    )


def _words(report: Report) -> str:
    from taxinet_ros.nodes.node_check import Status

    findings = report.findings
    count = Counter(one.status for one in findings)
    left: dict[str, list[str]] = {}
    for one in findings:
        if one.status is Status.NOT_TRIED:
            left.setdefault(one.came, []).append(one.clause.name)
    return '\n'.join([
        *(_line(one) for one in findings if one.status is not Status.NOT_TRIED),
        *(_wrapped(f'{Status.NOT_TRIED} ', f'{", ".join(names)}: {why}')
          for why, names in left.items()),
        f'{report.role.word}: {count[Status.PASS]} kept, {count[Status.FAIL]} broken, '
        f'{count[Status.NOT_TRIED]} not tried',
    ])


def _line(one: Finding) -> str:
    from taxinet_ros.nodes.node_check import Status

    text = f'{one.expected}: {one.came}'
    if one.status is Status.FAIL:
        text = f'expected: {one.expected}; got: {one.came}; fix: {one.clause.mend}'
    return _wrapped(f'{one.status:<9} {one.clause.name:<{_NAME_WIDTH}} ', text)


def _wrapped(head: str, text: str) -> str:
    return textwrap.fill(
        text, _LINE_WIDTH, initial_indent=head, subsequent_indent=' ' * len(head),
        break_long_words=False, break_on_hyphens=False,
    )


def _json(report: Report) -> str:
    return json.dumps({
        'role': report.role.word,
        'kept': not report.broken,
        'clauses': [
            {
                'clause': one.clause.name, 'status': str(one.status), 'expected': one.expected,
                'came': one.came, 'mend': one.clause.mend,
            } for one in report.findings
        ],
    }, indent=2)
