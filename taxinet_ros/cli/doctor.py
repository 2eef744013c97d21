"""``taxinet doctor``: whether all that lies in a folder of results is what was written there."""

from __future__ import annotations

import json
import shlex
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from taxinet_ros.campaign.doctor import Examination, examine, mend
from taxinet_ros.cli.bag_errors import LOSSY, WHOLE


def run_doctor(folder: Path, *, mended: bool, as_json: bool) -> int:
    """Check a folder, after mending it if asked, and print a line for each finding.

    Returns:
        Exit code: 0 all is sound, 3 something is not whole.

    Raises:
        UsageError: there is nothing to be checked, or somebody is at work on it.
    """
    done = mend(folder) if mended else []
    found = examine(folder, _progress)
    if sys.stderr.isatty():
        print('\r\033[K', end='', file=sys.stderr)
    print(_json(found, done, folder) if as_json else _words(found, done, folder))
    return LOSSY if found.findings else WHOLE


def _progress(bag: Path) -> None:
    if sys.stderr.isatty():
        print(f'\r\033[K{bag.name}', end='', file=sys.stderr, flush=True)


def _words(found: Examination, done: list[str], folder: Path) -> str:
    looked_at = ', '.join(f'{count:,} {what}' for what, count in found.looked_at.items())
    mends = Counter(_filled(one.mend, folder) for one in found.findings)
    lost = mends.pop('', 0)
    parts = [f'{number} mended by: {command}' for command, number in mends.items()]
    parts += [f'{lost} by nothing but making it again'] if lost else []
    summary = f'{len(found.findings)} found; {"; ".join(parts)}' if found.findings else 'sound'
    return '\n'.join([
        *(f'mended  {line}' for line in done),
        *(f'BAD     {one.where}: {one.what}' for one in found.findings),
        *(f'note    {line}' for line in found.notes),
        f'{folder}: {looked_at}: {summary}',
    ])


def _json(found: Examination, done: list[str], folder: Path) -> str:
    return json.dumps({
        'folder': str(folder), 'sound': not found.findings, 'looked_at': found.looked_at,
        'mended': done, 'notes': found.notes, 'not_checked': list(map(str, found.unchecked)),
        'findings': [
            {**asdict(one), 'mend': _filled(one.mend, folder)} for one in found.findings
        ],
    }, indent=2)


def _filled(command: str, folder: Path) -> str:
    return command.replace('{folder}', shlex.quote(str(folder)))
