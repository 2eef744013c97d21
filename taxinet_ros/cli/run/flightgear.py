"""``taxinet flightgear``: start FlightGear as a camera, and see whether it works as one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from rich.console import Console

from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import ExitCode, InfraError, InfraKind, UsageError
from taxinet_ros.processes.interrupts import ToldInterrupt
from taxinet_ros.extras.flightgear.camera import FlightGearCamera
from taxinet_ros.extras.flightgear.client import (
    ADDRESS,
    DEFAULT_ADDRESS,
    FlightGear,
    check_instance,
    failed,
    flightgear_address,
)
from taxinet_ros.extras.flightgear.process import (
    StartOptions,
    find_program,
    parse_size,
    program_version,
    started,
)

_PLACE = 'bikf_10'
_PICTURES = 5
_LOOK_S = 0.2


def run_flightgear(*, port: int | None, airport: str, size: str) -> None:
    """Start FlightGear, say when it has loaded, and end it on Ctrl-C.

    Raises:
        UsageError: bad options, or something is not installed.
        InfraError: it ended by itself.
        ToldInterrupt: after Ctrl-C or SIGTERM.
    """
    host, usual = flightgear_address()
    options = StartOptions(
        host=host, port=usual if port is None else port, airport=airport.upper(),
        size_px=parse_size(size),
    )
    console = Console(highlight=False)
    told_s = 0.0

    def wait(waited_s: float) -> None:
        nonlocal told_s
        if waited_s - told_s > 30:
            told_s = waited_s
            console.print(f'loading for {waited_s:.0f} s')

    begun_s = time.monotonic()
    console.print(f'starting FlightGear at {options.airport}; this takes a minute or two')
    try:
        with started(options, wait) as process:
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


def check_flightgear() -> int:
    """Print, line by line, whether FlightGear is installed, runs, and shows what is asked for.

    Returns:
        Exit code: 0, or 4 if something is missing.
    """
    console, broken = Console(highlight=False), False
    for name, check in _CHECKS.items():
        try:
            lines = list(check())
        except (UsageError, InfraError) as error:
            broken = True
            console.print(f'{name}: {error}', soft_wrap=True, markup=False)
            continue
        for line in lines:
            console.print(f'{name}: {line}', soft_wrap=True, markup=False)
    return ExitCode.INFRA if broken else ExitCode.OK


def _installed() -> Iterator[str]:
    yield f'{find_program("fgfs")}, version {program_version()}'
    yield find_program('Xvfb')


def _running() -> Iterator[str]:
    flightgear = FlightGear()
    try:
        check_instance(flightgear)
        yield f'version {flightgear.value("/sim/version/flightgear")} at {flightgear.where}'
        yield f'drawn by {flightgear.value("/sim/rendering/gl-renderer")}'
        height, width, _ = flightgear.picture().shape
        yield f'window of {width} x {height}'
    finally:
        flightgear.close()


def _pictures() -> Iterator[str]:
    scene = Scenario(place=_PLACE)
    camera = FlightGearCamera(scene)
    try:
        yield (
            f'{_PLACE} is {camera.ground.moved_m:.1f} m from the runway that FlightGear has, on '
            'which it is laid'
        )
        state = Aircraft(scene).state
        first, begun_s = camera.render(state, 0), time.monotonic()
        for number in range(_PICTURES):
            camera.render(replace(state, x_m=state.x_m + 20.0 * (number + 1)), 0)
        each_s = (time.monotonic() - begun_s) / _PICTURES
        again = camera.render(state, 0)
        away = int(np.abs(first.astype(np.int16) - again).max())
        yield f'{each_s:.2f} s each; moved away and back, they differ by {away} of 255 at most'
    finally:
        camera.close()


_CHECKS: dict[str, Callable[[], Iterator[str]]] = {
    'installed': _installed, 'running': _running, 'pictures': _pictures,
}
