"""``taxinet xplane``: what of X-Plane works."""

from __future__ import annotations

import os

import typer

from taxinet_ros.cli.help import command_group
from taxinet_ros.errors import ExitCode

_MARKS = {True: 'ok', False: 'BAD', None: '--'}

app = command_group('X-Plane as camera and as world.')


@app.command('doctor')
def xplane_doctor() -> None:
    """Check what a run with X-Plane relies on, in a line each.

    X-Plane has to run, with an aircraft on the ground near the runway. It is paused, its aircraft
    is placed, driven for a second, and released. TAXINET_XPLANE names the YAML file that says where
    it is and how it is used.

    Exit code 4 if something does not work.
    """
    from taxinet_ros.extras.xplane.doctor import findings
    from taxinet_ros.extras.xplane.setup import VARIABLE, chosen_setup

    chosen, where = chosen_setup(), os.environ.get(VARIABLE) or 'the defaults'
    print(f'ok   setup     {chosen.wire} at {chosen.host}:{chosen.port}, of {where}', flush=True)
    bad = False
    for found in findings(chosen):
        bad |= found.fine is False
        print(f'{_MARKS[found.fine]:<4} {found.name:<9} {found.words}', flush=True)
    raise typer.Exit(ExitCode.INFRA if bad else ExitCode.OK)
