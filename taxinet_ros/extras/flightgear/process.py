"""Start FlightGear under a virtual display, and end it: ``taxinet flightgear start``.

It draws in software (llvmpipe), so no graphics card is needed. What decides its speed there is
texture filtering: with its default, eight-fold anisotropic, a frame of 480 x 288 takes two seconds;
without, 25 ms. Random objects, vegetation and 3-D clouds are off: they would differ from start to
start.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.extras.flightgear.client import ADDRESS, AIRCRAFT, MOTION, FlightGear, failed
from taxinet_ros.processes.child import ChildProcess

DEFAULT_SIZE_PX = 480, 288
"""Window that holds the wing camera's view at its own resolution."""
_LEAST_PX, _MOST_PX = 64, 4096
_PROGRAMS = {'fgfs': 'flightgear', 'Xvfb': 'xvfb'}
"""Debian package by program."""
_GAMES = '/usr/games'
_LOAD_S, _POLL_S, _DISPLAY_S = 1800.0, 0.5, 60.0
_OPTIONS = (
    f'--aircraft={AIRCRAFT}', f'--fdm={MOTION}', '--ignore-autosave', '--season=summer',
    '--disable-sound', '--disable-ai-models', '--disable-ai-traffic', '--disable-terrasync',
    '--disable-real-weather-fetch', '--disable-splash-screen', '--disable-hud',
    '--disable-fullscreen', '--disable-random-objects', '--disable-random-vegetation',
    '--disable-random-buildings', '--disable-clouds3d', '--disable-distance-attenuation',
    '--texture-filtering=1', '--visibility=5000',
    '--prop:/sim/menubar/visibility=false', '--prop:/nasal/local_weather/enabled=false',
    '--prop:/sim/rendering/multi-sample-buffers=0', '--prop:/sim/rendering/multi-samples=0',
    '--prop:/sim/rendering/shaders/quality-level=0', '--prop:/sim/rendering/shaders/skydome=false',
    '--prop:/sim/rendering/shadows-enabled=false', '--prop:/sim/frame-rate-throttle-hz=5',
)


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of a window in pixels from ``480x288``."""
    width, _, height = text.partition('x')
    if not all(part.isascii() and part.isdigit() and len(part) < 6 for part in (width, height)):
        raise UsageError(f'size {text}: expected WIDTHxHEIGHT, such as 480x288')
    if not all(_LEAST_PX <= int(side) <= _MOST_PX for side in (width, height)):
        raise UsageError(f'size {text}: sides are {_LEAST_PX}..{_MOST_PX} px')
    return int(width), int(height)


def find_program(name: str) -> str:
    """Path of a program."""
    path = os.pathsep.join([os.environ.get('PATH', os.defpath), _GAMES])
    found = shutil.which(name, path=path)
    if found is None:
        raise UsageError(
            f'flightgear: {name} is not installed; on Debian: apt-get install {_PROGRAMS[name]}'
        )
    return found


def home_folder() -> Path:
    """FlightGear's own folder for caches, apart from the user's."""
    cache = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(cache) / 'taxinet_ros' / 'flightgear'


@contextlib.contextmanager
def started(
    host: str, port: int, *, airport: str = 'BIKF', size_px: tuple[int, int] = DEFAULT_SIZE_PX
) -> Iterator[ChildProcess]:
    """Context of a FlightGear that has loaded; it ends, with its display, at the end.

    Args:
        host: of its HTTP server.
        port: of it.
        airport: ICAO code of the airport whose terrain is loaded first.
        size_px: width and height of its window.
    """
    if not (airport.isalnum() and airport.isascii()):
        raise UsageError(f'at {airport}: not the code of an airport')
    programs = {name: find_program(name) for name in _PROGRAMS}
    _check_free(host, port)
    home = home_folder()
    try:
        home.mkdir(parents=True, exist_ok=True)
        log = home / f'fgfs-{port}.log'
        log.unlink(missing_ok=True)
    except OSError as error:
        raise UsageError(f'flightgear: {error.filename}: {error.strerror}') from error
    with _display(programs['Xvfb'], size_px) as display:
        environment = {
            **os.environ, 'DISPLAY': display, 'FG_HOME': str(home), 'LIBGL_ALWAYS_SOFTWARE': '1',
            'GALLIUM_DRIVER': 'llvmpipe',
            # Without a session bus, its screen saver's request would abort it.
            'DBUS_FATAL_WARNINGS': '0',
        }
        command = [
            programs['fgfs'], f'--httpd={host}:{port}', f'--airport={airport.upper()}',
            f'--geometry={size_px[0]}x{size_px[1]}', *_OPTIONS,
        ]
        with ChildProcess(
            'fgfs', command, log=log, environment=environment, killed_with_parent=True,
        ) as process:
            _await_loaded(process, FlightGear((host, port)), log)
            yield process


def _check_free(host: str, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UsageError(
                f'flightgear: {host}:{port}: {error.strerror}; choose another {ADDRESS}, or use '
                'the one that runs there'
            ) from error


@contextlib.contextmanager
def _display(program: str, size_px: tuple[int, int]) -> Iterator[str]:
    """Context of a virtual display; its number is the first free one."""
    # The window is put somewhere in the middle.
    screen = f'{2 * size_px[0] + 256}x{2 * size_px[1] + 256}x24'
    reading, writing = os.pipe()
    try:
        with ChildProcess(
            'Xvfb', [program, '-displayfd', str(writing), '-screen', '0', screen, '-nolisten',
                     'tcp'],
            environment=dict(os.environ), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            descriptors=(writing,), killed_with_parent=True,
        ) as process:
            os.close(writing)
            writing = -1
            number, begun_s = b'', time.monotonic()
            os.set_blocking(reading, False)
            while not number.endswith(b'\n'):
                with contextlib.suppress(BlockingIOError):
                    number += os.read(reading, 16)
                if process.dead or time.monotonic() - begun_s > _DISPLAY_S:
                    raise failed(InfraKind.DIED, f'Xvfb did not start: {process.how_it_ended}')
                time.sleep(0.02)
            yield f':{int(number)}'
    finally:
        for one in (reading, writing):
            if one >= 0:
                os.close(one)


def _await_loaded(process: ChildProcess, flightgear: FlightGear, log: Path) -> None:
    begun_s = time.monotonic()
    with contextlib.closing(flightgear):
        while not process.dead:
            waited_s = time.monotonic() - begun_s
            if waited_s > _LOAD_S:
                raise failed(
                    InfraKind.NOT_READY, f'fgfs has not loaded in {waited_s:.0f} s; see {log}'
                )
            with contextlib.suppress(InfraError):  # it answers late, and slowly
                if flightgear.value('/sim/sceneryloaded') is True:
                    return
            time.sleep(_POLL_S)
    raise failed(InfraKind.DIED, f'fgfs ended while loading; see {log}')
