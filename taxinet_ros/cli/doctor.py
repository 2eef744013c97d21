"""``taxinet doctor``: check this machine, a bag, or a folder of results."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode
from taxinet_ros.files.plain_values import plain

if TYPE_CHECKING:
    from taxinet_ros.bag.check.findings import Check, Finding

_STYLES = {'ok': 'green', 'missing': 'yellow', 'broken': 'bold red'}


def doctor(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar='[BAG|FOLDER]',
            help='folder or .mcap file of a bag; or folder of a campaign, experiment, dataset or '
            'study, or one that contains some; without it, this machine is checked',
        ),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Check this machine, a bag, or every file in a results folder.

    Without a path: Python, compiler, packages, ROS, messages, domain, discovery, memory, limits,
    disk and a short run, each with its fix; exit code 4 if something is broken.

    A bag: its checksums, counts, stamps, type hashes, the completeness of every step, and the
    verdict, with every figure in it, against the recorded truth; each problem with its fix.

    A folder of results: every record, each bag against its row and each dataset image against its
    label; makes tables again that do not say what their record says, and finds leftovers of killed
    processes. The command that made it goes on with `--resume`.

    Exit codes of both: 0 no findings, 3 something is incomplete or damaged, 2 nothing to check.
    """
    if path is None:
        return _check_machine(as_json=as_json)
    from taxinet_ros.bag.layout import holds_results
    from taxinet_ros.cli.bag.input import exit_code_of

    if path.is_dir() and holds_results(path):
        return _check_results(path, as_json=as_json)
    return exit_code_of(path, lambda: _check_bag(path, as_json=as_json))


def _check_results(folder: Path, *, as_json: bool) -> int:
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


def _check_bag(bag: Path, *, as_json: bool) -> int:
    from taxinet_ros.bag.check.doctor import check_bag

    checks = check_bag(bag).checks
    _print_checks(bag, checks, as_json=as_json)
    return ExitCode.INCOMPLETE if any(check.findings for check in checks) else ExitCode.OK


def _print_checks(bag: Path, checks: tuple[Check, ...], *, as_json: bool) -> None:
    """Print one line per check, its findings and the repair command."""
    from taxinet_ros.bag.check.findings import conclusion

    findings = [finding for check in checks for finding in check.findings]
    if as_json:
        print_json({
            'bag': bag, 'sound': not findings,
            'checks': [
                {**plain(check), 'findings': [
                    {**plain(finding), 'fix': _fix(finding, bag)} for finding in check.findings
                ]} for check in checks
            ],
        })
        return
    console = line_console()
    for check in checks:
        console.print(_check_line(check))
        for finding in check.findings:
            console.print(f'        {finding.where}: {finding.what}')
    fixes = [_fix(finding, bag) for finding in findings]
    console.print(conclusion(fixes) or 'nothing is wrong')


def _check_line(check: Check) -> Text:
    if check.skipped:
        word, style = 'skip', 'dim'
    elif check.findings:
        word, style = 'BAD', 'bold red'
    else:
        word, style = 'ok', 'green'
    text = Text()
    text.append(f'{word:<5}', style=style)
    text.append(f'{check.name:<12}{check.looked_at}')
    return text


def _fix(finding: Finding, bag: Path) -> str:
    return finding.fix.replace('{bag}', shlex.quote(str(bag)))


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
