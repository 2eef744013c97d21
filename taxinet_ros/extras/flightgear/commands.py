"""``taxinet flightgear``: start FlightGear as a camera, and see whether it works as one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Annotated

import typer

from taxinet_ros.cli.help import command_group
from taxinet_ros.errors import ExitCode, InfraError, InfraKind, UsageError

_PLACE = 'bikf_10'
_PICTURES = 5
_LOOK_S = 0.2

app = command_group('FlightGear as a camera: start it, and see whether it works.')


@app.command('start')
def flightgear_start(
    at: Annotated[
        str, typer.Option(metavar='ICAO', help='airport whose terrain is loaded first')
    ] = 'BIKF',
    size: Annotated[
        str, typer.Option(metavar='WIDTHxHEIGHT', help='window; larger for sharper lenses')
    ] = '480x288',
    port: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help='port on this machine (default: that of TAXINET_FLIGHTGEAR, '
            'else 5480)',
        ),
    ] = None,
) -> None:
    """Start FlightGear under a virtual display, and keep it until Ctrl-C.

    Says when it has loaded; then --camera flightgear takes its pictures from it. Exit code 130
    after Ctrl-C, 4 if FlightGear ended by itself.
    """
    from rich.console import Console

    from taxinet_ros.extras.flightgear.client import (
        ADDRESS,
        DEFAULT_ADDRESS,
        failed,
        flightgear_address,
    )
    from taxinet_ros.extras.flightgear.process import StartOptions, parse_size, started
    from taxinet_ros.processes.interrupts import ToldInterrupt

    host, usual = flightgear_address()
    options = StartOptions(
        host=host, port=usual if port is None else port, airport=at.upper(),
        size_px=parse_size(size),
    )
    console = Console(highlight=False)
    begun_s = time.monotonic()
    console.print(f'starting FlightGear at {options.airport}; this takes a minute or two')
    try:
        with started(options) as process:
            where = f'{options.host}:{options.port}'
            aside = '' if where == DEFAULT_ADDRESS else f' (with {ADDRESS}={where})'
            console.print(
                f'loaded in {time.monotonic() - begun_s:.0f} s: --camera flightgear takes its '
                f'pictures from {where}{aside}; Ctrl-C ends it', soft_wrap=True,
            )
            while not process.dead:
                time.sleep(_LOOK_S)
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

    console, broken = Console(highlight=False), False
    for name, check in _CHECKS.items():
        try:
            for line in check():
                console.print(f'{name}: {line}', soft_wrap=True, markup=False)
        except (UsageError, InfraError) as error:
            broken = True
            console.print(f'{name}: {error}', soft_wrap=True, markup=False)
    raise typer.Exit(ExitCode.INFRA if broken else ExitCode.OK)


def _installed() -> Iterator[str]:
    from taxinet_ros.extras.flightgear.process import find_program

    yield f'{find_program("fgfs")}, {find_program("Xvfb")}'


def _running() -> Iterator[str]:
    from taxinet_ros.extras.flightgear.client import FlightGear, check_instance

    flightgear = FlightGear()
    try:
        check_instance(flightgear)
        width_px, height_px = flightgear.window_px
        yield (
            f'version {flightgear.value("/sim/version/flightgear")} at {flightgear.where}, window '
            f'of {width_px} x {height_px}'
        )
    finally:
        flightgear.close()


def _pictures() -> Iterator[str]:
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
    yield f'{each_s:.2f} s each; moved away and back, they differ by {away} of 255 at most'


_CHECKS: dict[str, Callable[[], Iterator[str]]] = {
    'installed': _installed, 'running': _running, 'pictures': _pictures,
}
