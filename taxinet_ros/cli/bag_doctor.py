"""``taxinet bag doctor``: every check of a bag, for people or as JSON."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.text import Text

from taxinet_ros.bag.checkup import check_bag
from taxinet_ros.bag.findings import Check, Finding
from taxinet_ros.bag.frame_check import frames_check
from taxinet_ros.cli.bag_errors import LOSSY, WHOLE, exit_code_of
from taxinet_ros.cli.bag_input import one_run


def run_doctor(
    bag: Path, *, as_json: bool, images: bool = False, run: str | None = None
) -> int:
    """Check a bag and print what was found.

    Args:
        bag: a run folder or an ``.mcap`` file.
        as_json: print one JSON object.
        images: render every frame once more, and compare.
        run: of which run, where the bag holds several.

    Returns:
        Exit code: 0 nothing is wrong, 3 something is, 1 not readable.

    Raises:
        UsageError: there is nothing at ``bag``.
    """
    return exit_code_of(bag, lambda: _run(bag, as_json, images, run))


def _run(bag: Path, as_json: bool, images: bool, run: str | None) -> int:
    checks = check_bag(bag).checks
    if images:
        with one_run(bag, run) as whole:
            checks += (frames_check(whole),)
    print_checks(bag, checks, as_json=as_json)
    return LOSSY if any(check.findings for check in checks) else WHOLE


def print_checks(bag: Path, checks: tuple[Check, ...], *, as_json: bool) -> None:
    """Print a line for each check, what each found, and what mends it."""
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
        console.print(_line(check), soft_wrap=True)
        for finding in check.findings:
            console.print(
                f'        {finding.where}: {finding.what}', soft_wrap=True, markup=False
            )
    console.print(_conclusion(findings, bag), soft_wrap=True, markup=False)


def _conclusion(findings: Sequence[Finding], bag: Path) -> str:
    if not findings:
        return 'nothing is wrong'
    mends = Counter(_mend(finding, bag) for finding in findings)
    lost = mends.pop('', 0)
    parts = [f'{number} mended by: {command}' for command, number in mends.items()]
    if lost:
        parts.append(f'{lost} by nothing but running the scene again')
    return f'{len(findings)} found, {"; ".join(parts)}'


def _line(check: Check) -> Text:
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
