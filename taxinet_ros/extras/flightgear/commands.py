"""``taxinet flightgear``: start FlightGear as a camera, and see whether it works as one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

import typer

from taxinet_ros.cli.help import command_group
from taxinet_ros.errors import ExitCode, InfraError, InfraKind, UsageError

_PLACE = 'bikf_10'
_PICTURES = 5
_POLL_S = 0.2

app = command_group('FlightGear as a camera: start it, and see whether it works.')


@app.command('start')
def flightgear_start(
    at: Annotated[
        str, typer.Option(metavar='ICAO', help='airport whose terrain is loaded first')
    ] = 'BIKF',
    size: Annotated[
        str, typer.Option(metavar='WIDTHxHEIGHT', help='window; larger for sharper lenses')
    ] = '480x288',
) -> None:
    """Start FlightGear under a virtual display, and keep it until Ctrl-C.

    It serves at TAXINET_FLIGHTGEAR=HOST:PORT, by default 127.0.0.1:5480, from where --camera
    flightgear takes its pictures. Says when it has loaded. Exit code 130 after Ctrl-C, 4 if
    FlightGear ended by itself.
    """
    from rich.console import Console

    from taxinet_ros.extras.flightgear.client import failed, flightgear_address
    from taxinet_ros.extras.flightgear.process import parse_size, started
    from taxinet_ros.processes.interrupts import ToldInterrupt

    (host, port), size_px = flightgear_address(), parse_size(size)
    console = Console(emoji=False, highlight=False)
    begun_s = time.monotonic()
    console.print(f'starting FlightGear at {at.upper()}; this takes a minute or two')
    try:
        with started(host, port, airport=at, size_px=size_px) as process:
            console.print(
                f'loaded in {time.monotonic() - begun_s:.0f} s: --camera flightgear takes its '
                f'pictures from {host}:{port}; Ctrl-C ends it', soft_wrap=True,
            )
            while not process.dead:
                time.sleep(_POLL_S)
            raise failed(InfraKind.DIED, f'fgfs ended: {process.how_it_ended}')
    except KeyboardInterrupt:
        console.print('FlightGear ended')
        raise ToldInterrupt from None


@app.command('doctor')
def flightgear_doctor() -> None:
    """Report whether FlightGear is installed, runs, and shows what is asked for.

    Exit code 4 if anything is missing.
    """
    from rich.console import Console

    console, broken = Console(emoji=False, highlight=False), False
    for name, check in _CHECKS.items():
        try:
            console.print(f'{name}: {check()}', soft_wrap=True, markup=False)
        except (UsageError, InfraError) as error:
            broken = True
            console.print(f'{name}: {error}', soft_wrap=True, markup=False)
    raise typer.Exit(ExitCode.INFRA if broken else ExitCode.OK)


def _installed() -> str:
    from taxinet_ros.extras.flightgear.process import find_program

    return f'{find_program("fgfs")}, {find_program("Xvfb")}'


def _running() -> str:
    from taxinet_ros.extras.flightgear.client import FlightGear, check_instance

    flightgear = FlightGear()
    try:
        check_instance(flightgear)
        width_px, height_px = flightgear.window_px
        return (
            f'version {flightgear.value("/sim/version/flightgear")} at {flightgear.where}, window '
            f'of {width_px} x {height_px}'
        )
    finally:
        flightgear.close()


def _pictures() -> str:
    import numpy as np

    from taxinet_ros.core.motion.aircraft import Aircraft
    from taxinet_ros.core.scenario import Scenario
    from taxinet_ros.extras.flightgear.camera import FlightGearCamera

    scene = Scenario(place=_PLACE)
    camera = FlightGearCamera(scene)
    state = Aircraft(scene).state
    first, begun_s = camera.render(state, 0), time.monotonic()
    for number in range(_PICTURES):
        camera.render(replace(state, x_m=state.x_m + 20.0 * (number + 1)), 0)
    each_s = (time.monotonic() - begun_s) / _PICTURES
    again = camera.render(state, 0)
    away = int(np.abs(first.astype(np.int16) - again).max())
    return f'{each_s:.2f} s each; moved away and back, they differ by {away} of 255 at most'


_CHECKS: dict[str, Callable[[], str]] = {
    'installed': _installed, 'running': _running, 'pictures': _pictures,
}
