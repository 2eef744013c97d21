"""``taxinet doctor``: check this machine, or a folder of results."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode

_STYLES = {'ok': 'green', 'missing': 'yellow', 'broken': 'bold red'}


def doctor(
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar='CAMPAIGN',
            help='folder of a campaign, experiment, dataset or study, or a folder that contains '
            'some; without it, this machine is checked',
        ),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Check this machine, or every file in a results folder.

    Without a folder: Python, compiler, packages, ROS, messages, domain, discovery, memory, limits,
    disk and a short run, each with its fix; exit code 4 if something is broken.

    With a folder: checks every record, each bag against its row and each dataset image against its
    label, makes tables again that do not say what their record says, and finds leftovers of killed
    processes. Exit codes: 0 no
    findings, 3 something is incomplete or damaged, 2 nothing to check. The command that made it
    goes on with `--resume`.
    """
    if folder is None:
        return _check_machine(as_json=as_json)
    from taxinet_ros.bag.check.findings import conclusion
    from taxinet_ros.trials.doctor import examine

    found = examine(folder, _show_bag_name)
    if sys.stderr.isatty():
        print('\r\033[K', end='', file=sys.stderr)
    if as_json:
        print_json({
            'folder': folder, 'sound': not found.findings, 'looked_at': found.looked_at,
            'notes': found.notes, 'not_checked': found.unchecked, 'findings': found.findings,
        })
    else:
        for one in found.findings:
            print(f'BAD     {one.where}: {one.what}')
        for line in found.notes:
            print(f'note    {line}')
        looked_at = ', '.join(f'{count:,} {what}' for what, count in found.looked_at.items())
        summary = conclusion([one.fix for one in found.findings]) or 'sound'
        print(f'{folder}: {looked_at}: {summary}')
    return ExitCode.INCOMPLETE if found.findings else ExitCode.OK


def _show_bag_name(bag: Path) -> None:
    if sys.stderr.isatty():
        print(f'\r\033[K{bag.name}', end='', file=sys.stderr, flush=True)


def _check_machine(*, as_json: bool) -> int:
    from taxinet_ros.machine import system_checks

    console, checks = line_console(stderr=as_json), []
    for check in system_checks():
        checks.append(check)
        text = Text(f'{check.state:<8}', style=_STYLES[check.state])
        text.append(f'{check.name:<15}', style='bold')
        text.append(check.found + (f'; {check.fix}' if check.fix else ''), style='default')
        console.print(text)
    broken = [check.name for check in checks if check.state == 'broken']
    if as_json:
        print_json(checks)
    else:
        console.print(
            f'broken: {", ".join(broken)}' if broken
            else 'everything that runs need is here; next: taxinet demo',
        )
    return ExitCode.INFRA if broken else ExitCode.OK
