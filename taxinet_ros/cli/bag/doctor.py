"""``taxinet bag doctor`` and ``taxinet doctor``: check a bag, or a folder of results."""

from __future__ import annotations

import json
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from taxinet_ros.cli.options import BagArgument, JsonOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode

if TYPE_CHECKING:
    from taxinet_ros.bag.check.findings import Check, Finding
    from taxinet_ros.trials.doctor import Examination


def bag_doctor(bag: BagArgument, as_json: JsonOption = False) -> int:
    """Check a bag; report each problem, where it is and how to repair it.

    Checks checksums, counts, stamps, type hashes, the completeness of every step, and the
    verdict, with every figure in it, against the recorded truth.
    """
    from taxinet_ros.bag.check.doctor import check_bag
    from taxinet_ros.cli.bag.input import exit_code_of

    def check() -> int:
        checks = check_bag(bag).checks
        _print_checks(bag, checks, as_json=as_json)
        return ExitCode.INCOMPLETE if any(check.findings for check in checks) else ExitCode.OK

    return exit_code_of(bag, check)


def _print_checks(bag: Path, checks: tuple[Check, ...], *, as_json: bool) -> None:
    """Print one line per check, its findings and the repair command."""
    findings = [finding for check in checks for finding in check.findings]
    if as_json:
        print(json.dumps({
            'bag': str(bag), 'sound': not findings,
            'checks': [
                {**asdict(check), 'findings': [_plain(finding, bag) for finding in check.findings]}
                for check in checks
            ],
        }, indent=2))
        return
    console = line_console()
    for check in checks:
        console.print(_check_line(check))
        for finding in check.findings:
            console.print(f'        {finding.where}: {finding.what}')
    mends = [_mend(finding, bag) for finding in findings]
    console.print(_conclusion(mends) or 'nothing is wrong')


def _conclusion(mends: Sequence[str]) -> str:
    """The commands for some findings, or '' for none."""
    counts = Counter(mends)
    lost = counts.pop('', 0)
    parts = [f'{number} mended by: {command}' for command, number in counts.items()]
    if lost:
        parts.append(f'{lost} only by making it again')
    return f'{len(mends)} found; {"; ".join(parts)}' if mends else ''


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


def _plain(finding: Finding, bag: Path) -> dict[str, str]:
    return {'where': finding.where, 'what': finding.what, 'mend': _mend(finding, bag)}


def _mend(finding: Finding, bag: Path) -> str:
    return finding.mend.replace('{bag}', shlex.quote(str(bag)))


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
    disk and a short run, each with its mend; exit code 4 if something is broken.

    With a folder: checks every record, each bag against its row and each dataset image against its
    label, makes tables again that do not say what their record says, and finds leftovers of killed
    processes. Exit codes: 0 no
    findings, 3 something is incomplete or damaged, 2 nothing to check. The command that made it
    goes on with `--resume`.
    """
    if folder is None:
        from taxinet_ros.cli.system import run_system_doctor

        return run_system_doctor(as_json=as_json)
    from taxinet_ros.trials.doctor import examine

    found = examine(folder, _show_bag_name)
    if sys.stderr.isatty():
        print('\r\033[K', end='', file=sys.stderr)
    print(_results_json(found, folder) if as_json else _results_words(found, folder))
    return ExitCode.INCOMPLETE if found.findings else ExitCode.OK


def _show_bag_name(bag: Path) -> None:
    if sys.stderr.isatty():
        print(f'\r\033[K{bag.name}', end='', file=sys.stderr, flush=True)


def _results_words(found: Examination, folder: Path) -> str:
    looked_at = ', '.join(f'{count:,} {what}' for what, count in found.looked_at.items())
    summary = _conclusion([one.mend for one in found.findings]) or 'sound'
    return '\n'.join([
        *(f'BAD     {one.where}: {one.what}' for one in found.findings),
        *(f'note    {line}' for line in found.notes),
        f'{folder}: {looked_at}: {summary}',
    ])


def _results_json(found: Examination, folder: Path) -> str:
    return json.dumps({
        'folder': str(folder), 'sound': not found.findings, 'looked_at': found.looked_at,
        'notes': found.notes, 'not_checked': list(map(str, found.unchecked)),
        'findings': [asdict(one) for one in found.findings],
    }, indent=2)
