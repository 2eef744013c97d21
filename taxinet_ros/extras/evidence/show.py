"""``taxinet evidence``: write evidence toward a requirement, and verify it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from rich.console import Console

from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.errors import ExitCode
from taxinet_ros.extras.evidence.argument import goals
from taxinet_ros.extras.evidence.evidence import (
    ARGUMENT_NAME,
    JSON_NAME,
    MANIFEST_NAME,
    PAGE_NAME,
    Collected,
    EvidenceOptions,
    make_evidence,
)
from taxinet_ros.extras.evidence.figures import Verdict
from taxinet_ros.extras.evidence.verify import Verification, VerifyOptions, verify

_WIDTH = 100


def run_evidence(options: EvidenceOptions, out: Path, *, as_json: bool) -> int:
    """Write evidence and print what it says.

    Args:
        options: what is asked for.
        out: folder to write; must be new.
        as_json: print the values of ``evidence.json``.

    Returns:
        Exit code: 0 written, and the claim, if there is one, is supported; 1 it is refuted; 3 it is
        undetermined.

    Raises:
        UsageError: bad input.
    """
    with stage_bars(Console(stderr=True)) as show:
        found = make_evidence(options, out, on_progress=show)
    if as_json:
        print(json.dumps(found.content, indent=2, allow_nan=False))
    else:
        _print(found, out)
    return _code(found)


def _code(found: Collected) -> ExitCode:
    verdicts = [one['claim']['verdict'] for one in found.content['systems'] if one['claim']]
    if Verdict.REFUTED in verdicts:
        return ExitCode.VIOLATED
    return ExitCode.INCOMPLETE if Verdict.UNDETERMINED in verdicts else ExitCode.OK


def _print(found: Collected, out: Path) -> None:
    content = found.content
    console = _console()
    for one in goals(content['argument']):
        word = 'undeveloped' if one['undeveloped'] else one['verdict']
        why = f' ({one["why"]})' if one['why'] else ''
        console.print(f'{one["id"]:<4}{word:<13}{one["text"]}{why}', soft_wrap=True)
    limits = content['limits']
    own = [one for one in limits if one['source'] == 'inputs']
    console.print(f'{len(limits)} known limits, {len(own)} of them from these inputs:',
                  soft_wrap=True)
    for limit in own:
        about = f'{limit["about"]}: ' if limit['about'] else ''
        console.print(f'  {about}{limit["words"]}', soft_wrap=True)
    unknown = [name for name, one in content['items'].items() if one['sha256'] is None]
    console.print(
        f'{len(content["items"])} items by hash'
        + (f', unknown: {", ".join(unknown)}' if unknown else ''), soft_wrap=True,
    )
    files = ', '.join((PAGE_NAME, JSON_NAME, ARGUMENT_NAME, MANIFEST_NAME))
    console.print(f'{out}: {files}', soft_wrap=True)
    console.print(f'next: taxinet evidence verify {out}', soft_wrap=True)


def run_verify(options: VerifyOptions, *, as_json: bool) -> int:
    """Verify evidence and print what holds and what does not.

    Returns:
        Exit code: see :attr:`.verify.Verification.code`.

    Raises:
        UsageError: the folder is none of evidence.
    """
    with stage_bars(Console(stderr=True)) as show:
        found = verify(options, show)
    if as_json:
        print(json.dumps({
            'folder': str(options.folder), 'holds': found.holds, 'checked': found.checked,
            'damaged': found.damaged, 'different': found.different,
            'unchecked': found.unchecked, 'notes': found.notes,
        }, indent=2))
    else:
        _print_verification(found, options)
    return found.code


def _print_verification(found: Verification, options: VerifyOptions) -> None:
    console = _console()
    for word, lines in (
        ('BAD', found.damaged), ('DIFFERS', found.different), ('unclear', found.unchecked),
        ('note', found.notes),
    ):
        for line in lines:
            console.print(f'{word:<8}{line}', soft_wrap=True)
    checked = ', '.join(f'{count:,} {what}' for what, count in found.checked.items()) or 'nothing'
    wrong = len(found.damaged) + len(found.different)
    verdict = 'all holds' if found.holds else (
        f'{wrong} do not hold' if wrong else 'not all could be verified'
    )
    console.print(f'{options.folder}: {checked}: {verdict}', soft_wrap=True)
    if found.damaged:
        print(
            f'taxinet: error: {options.folder}: evidence does not hold: {found.damaged[0]}',
            file=sys.stderr,
        )


def _console() -> Console:
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = _WIDTH
    return console
