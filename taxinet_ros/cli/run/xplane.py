"""``taxinet xplane doctor``: what of X-Plane works."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.errors import ExitCode
from taxinet_ros.extras.xplane.doctor import Doctor
from taxinet_ros.extras.xplane.setup import VARIABLE, chosen_setup, read_setup

_MARKS = {True: 'ok', False: 'BAD', None: '--'}


def run_xplane_doctor(setup: Path | None) -> int:
    """Print the findings.

    Returns:
        Exit code: 0, or 4 if something does not work.

    Raises:
        UsageError: the setup file is invalid.
    """
    chosen = chosen_setup() if setup is None else read_setup(setup)
    where = setup or f'{VARIABLE} or its defaults'
    print(f'ok   setup     {chosen.wire} at {chosen.host}:{chosen.port}, of {where}', flush=True)
    bad = False
    for found in Doctor(chosen).findings():
        bad |= found.fine is False
        print(f'{_MARKS[found.fine]:<4} {found.name:<9} {found.words}', flush=True)
    return ExitCode.INFRA if bad else ExitCode.OK
