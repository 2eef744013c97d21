"""Ask a running FlightGear over its HTTP server, and tell its failures apart.

FlightGear 2020.3 serves its property tree as JSON (``/json/PATH``), runs commands
(``/run.cgi?value=COMMAND``; the command ``nasal`` runs a script within a frame) and takes
screenshots (``/screenshot?type=ppm``; a PNG costs five times as long). A request takes two rendered
frames, to be read and to be answered; requests of two connections share them. Its JSON has six
decimals, so exact values come as text, from a script.
"""

from __future__ import annotations

import contextlib
import fcntl
import http.client
import json
import os
import re
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.files.plain_values import load_json

ADDRESS = 'TAXINET_FLIGHTGEAR'
"""Environment variable with the address of the FlightGear to ask, HOST:PORT."""
DEFAULT_ADDRESS = '127.0.0.1:5480'
VERSION = '2020.3'
"""The known version; its properties and scripts are those of no other."""
AIRCRAFT, MOTION = 'ufo', 'external'
"""Aircraft and flight model that leave the eye where it is put."""

_ANSWER_S = 60.0
"""A frame takes a fraction of a second; on a busy machine, seconds."""
_PPM = re.compile(rb'P6\s([1-9]\d{0,4})\s([1-9]\d{0,4})\s255\s')
_RUN, _PICTURE = '/run.cgi?value=nasal', '/screenshot?type=ppm'


def _of(path: str) -> str:
    return f'/json{quote(path)}'


def flightgear_address() -> tuple[str, int]:
    """Host and port of the FlightGear to ask."""
    address = os.environ.get(ADDRESS) or DEFAULT_ADDRESS
    host, _, port = address.rpartition(':')
    if not (host and port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise UsageError(f'{ADDRESS}={address}: expected HOST:PORT, such as {DEFAULT_ADDRESS}')
    return host, int(port)


def failed(kind: InfraKind, detail: str) -> InfraError:
    """Error of the camera; the run adds its step."""
    return InfraError(kind, 'simulator', -1, f'camera flightgear: {detail}')


class FlightGear:
    """A connection to a running FlightGear."""

    def __init__(self, address: tuple[str, int] | None = None) -> None:
        """Remember whom to ask, by default the environment's; nothing is asked yet."""
        self.host, self.port = address or flightgear_address()
        # It answers in the frame after that of a request, each connection for itself.
        self._connection, self._second = (
            http.client.HTTPConnection(self.host, self.port, timeout=_ANSWER_S) for _ in range(2)
        )
        for connection in (self._connection, self._second):
            weakref.finalize(self, connection.close)
        self._answered = False
        self.ready = False
        """Whether it has been prepared; False again when the connection was lost."""
        self.window_px = 0, 0
        """Width and height of its window, known after :func:`check_instance`."""

    @property
    def where(self) -> str:
        """Its address."""
        return f'{self.host}:{self.port}'

    def close(self) -> None:
        """Close the connection; FlightGear goes on."""
        self.ready = False
        self._connection.close()
        self._second.close()

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Context in which no other process of this machine asks this FlightGear."""
        name = f'taxinet-flightgear-{os.getuid()}-{self.host.replace("/", "_")}-{self.port}.lock'
        try:
            with Path(tempfile.gettempdir(), name).open('a') as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                yield
        except OSError as error:
            raise failed(InfraKind.SIM, f'{error.filename or name}: {error.strerror}') from error

    def value(self, path: str) -> Any:
        """Value of a property; None if there is none."""
        self._ask(self._connection, 'GET', _of(path))
        return self._parsed(self._answer(self._connection, _of(path)))

    def run(self, script: str) -> None:
        """Run a Nasal script within one frame."""
        body = {'name': '', 'children': [{'name': 'script', 'value': script}]}
        self._ask(self._connection, 'POST', _RUN, json.dumps(body))
        answer = self._answer(self._connection, _RUN)
        if answer.strip() != b'ok.':
            raise failed(InfraKind.PROTOCOL, f'{self.where} refused a script: {answer[:60]!r}')

    def value_and_picture(self, path: str) -> tuple[Any, NDArray[np.uint8]]:
        """Value of a property and the window's newest picture, in the time of one of them.

        The picture is (height, width, 3) uint8 RGB, read-only.
        """
        self._ask(self._connection, 'GET', _of(path))
        self._ask(self._second, 'GET', _PICTURE)
        value = self._answer(self._connection, _of(path))
        picture = self._answer(self._second, _PICTURE)
        return self._parsed(value), self._unpacked(picture)

    def _parsed(self, answer: bytes) -> Any:
        try:
            return load_json(answer).get('value')
        except (ValueError, AttributeError):
            raise failed(
                InfraKind.PROTOCOL, f'{self.where} does not answer like FlightGear: {answer[:40]!r}'
            ) from None

    def _unpacked(self, answer: bytes) -> NDArray[np.uint8]:
        found = _PPM.match(answer)
        width, height = map(int, found.groups()) if found else (0, 0)
        data = answer[found.end():] if found else b''
        if not found or len(data) != width * height * 3:
            raise failed(
                InfraKind.PROTOCOL, f'{self.where} answered no whole picture: {answer[:20]!r}, '
                f'{len(answer)} bytes'
            )
        return np.frombuffer(data, np.uint8).reshape(height, width, 3)

    def _ask(
        self, connection: http.client.HTTPConnection, method: str, path: str,
        body: str | None = None,
    ) -> None:
        headers = {} if body is None else {'Content-Type': 'application/json'}
        with self._reported():
            connection.request(method, path, body, headers)

    def _answer(self, connection: http.client.HTTPConnection, path: str) -> bytes:
        with self._reported():
            response = connection.getresponse()
            answer = response.read()
        if response.status != 200:
            self.close()
            raise failed(
                InfraKind.PROTOCOL, f'{self.where}{path} answered {response.status} '
                f'{response.reason}'
            )
        self._answered = True
        return answer

    @contextlib.contextmanager
    def _reported(self) -> Iterator[None]:
        """Context in which failures of a connection become infrastructure errors."""
        try:
            yield
        except TimeoutError as error:
            self.close()
            raise failed(
                InfraKind.TIMEOUT, f'{self.where} has not answered for {_ANSWER_S:g} s'
            ) from error
        except (OSError, http.client.HTTPException) as error:
            self.close()
            why = (error.strerror if isinstance(error, OSError) else '') or type(error).__name__
            if self._answered:
                raise failed(InfraKind.DIED, f'{self.where} answers no more: {why}') from error
            raise failed(
                InfraKind.NOT_READY, f'nobody answers at {self.where}: {why}; start it with: '
                f'taxinet flightgear start (or name another address in {ADDRESS})'
            ) from error


def check_instance(flightgear: FlightGear) -> None:
    """Check that this is a FlightGear as ``taxinet flightgear start`` starts it."""
    version = flightgear.value('/sim/version/flightgear')
    if not isinstance(version, str) or not version.startswith(f'{VERSION}.'):
        raise failed(
            InfraKind.PROTOCOL, f'{flightgear.where} is FlightGear {version}; known is {VERSION}'
        )
    for path, wanted, what in (
        ('/sim/aircraft', AIRCRAFT, 'aircraft'), ('/sim/flight-model', MOTION, 'flight model'),
    ):
        found = flightgear.value(path)
        if found != wanted:
            raise failed(
                InfraKind.PROTOCOL, f'{flightgear.where} has the {what} {found}, which may move '
                f'the eye; start it with: taxinet flightgear start'
            )
    loaded, picture = flightgear.value_and_picture('/sim/sceneryloaded')
    if loaded is not True:
        raise failed(InfraKind.NOT_READY, f'{flightgear.where} is still loading its scenery')
    flightgear.window_px = picture.shape[1], picture.shape[0]
