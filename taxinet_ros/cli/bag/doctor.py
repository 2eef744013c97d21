"""``taxinet bag doctor`` and ``taxinet doctor``: check a bag, or a folder of results."""

from __future__ import annotations

import json
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.text import Text

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.check.findings import Check, Finding
from taxinet_ros.cli.bag.input import exit_code_of
from taxinet_ros.errors import ExitCode
from taxinet_ros.trials.doctor import Examination, examine


def run_bag_doctor(bag: Path, *, as_json: bool) -> int:
    """Check a bag and print the findings; exit code 0 nothing is wrong, 2 not readable, 3 wrong."""
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
    console = Console(highlight=False)
    for check in checks:
        console.print(_check_line(check), soft_wrap=True)
        for finding in check.findings:
            console.print(
                f'        {finding.where}: {finding.what}', soft_wrap=True, markup=False
            )
    mends = [_mend(finding, bag) for finding in findings]
    console.print(_conclusion(mends) or 'nothing is wrong', soft_wrap=True, markup=False)


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


def run_results_doctor(folder: Path, *, as_json: bool) -> int:
    """Check a folder and print one line per finding; exit code 3 if there is one."""
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
