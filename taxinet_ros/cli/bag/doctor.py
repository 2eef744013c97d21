"""``taxinet bag doctor``: check a bag."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from taxinet_ros.cli.options import BagArgument, JsonOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode
from taxinet_ros.files.plain_values import plain

if TYPE_CHECKING:
    from taxinet_ros.bag.check.findings import Check, Finding


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
