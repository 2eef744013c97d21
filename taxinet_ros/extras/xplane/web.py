"""Client of X-Plane 12's web API: datarefs and commands over REST.

The API came with X-Plane 12.1.1; commands and ``/api/capabilities``, which runs need, with 12.1.4
(v2). Values of the stream over WebSocket are never used: they come ten times a second by the clock
of the wall.

Source: "X-Plane local Web API", developer.x-plane.com, as of January 2026.
"""

from __future__ import annotations

import base64
import functools
import http.client
import json
import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar
from urllib.parse import quote

from taxinet_ros.core.datarefs import split_name
from taxinet_ros.errors import InfraError, InfraKind
from taxinet_ros.extras.xplane.wire import Value, address_of, failed
from taxinet_ros.files.plain_values import load_json

PORT = 8086
VERSIONS = ('v3', 'v2')
"""Versions of the API that the client speaks, the best first."""
_HEADERS = {'Accept': 'application/json', 'Content-Type': 'application/json'}
_MOST_BYTES = 1 << 22
_T = TypeVar('_T')


class Dataref(NamedTuple):
    """A dataref by its number in this session of X-Plane; an index means one of its elements."""

    id: int
    type: str
    writable: bool
    element: int | None


class WebApi:
    """Client of one simulator's web API.

    All methods raise InfraError where there is no valid answer in time.

    Attributes:
        words: what it is and where, for messages.
        version: of X-Plane, as ``12.1.4``; '' before its first answer.
    """

    def __init__(
        self, host: str, port: int = PORT, *, timeout_s: float = 3.0, tries: int = 3
    ) -> None:
        """Connect and agree on a version.

        X-Plane itself listens on its own machine only; from another one, a proxy or tunnel has to
        lead there. Its option ``--web_server_port`` names the port.
        """
        self.words, self.version = f'web API at {host}:{port}', ''
        self._connection = http.client.HTTPConnection(address_of(host), port, timeout=timeout_s)
        self._timeout_s, self._tries = timeout_s, tries
        self._known: dict[str, Dataref] = {}
        self._asked, self._answer = '', b''
        try:
            self.version, api = self._again(self._negotiate)
        except BaseException:
            self.close()
            raise
        self._api, self.words = f'/api/{api}', f'web API {api} at {host}:{port}'

    def _negotiate(self) -> tuple[str, str]:
        answer = self._ask('GET', '/api/capabilities', optional=True)
        if answer is None:
            raise failed(
                InfraKind.PROTOCOL, f'{self.words}: it has no /api/capabilities; X-Plane 12.1.4 or '
                'newer is needed'
            )
        version, offered = str(answer['x-plane']['version']), list(answer['api']['versions'])
        common = [one for one in VERSIONS if one in offered]
        if not common:
            raise failed(
                InfraKind.PROTOCOL, f'{self.words}: X-Plane {version:.20} offers the versions '
                f'{offered!r:.60}; the client speaks {", ".join(VERSIONS)}'
            )
        return version, common[0]

    def close(self) -> None:
        """Close the connection; ids are asked for again on the next, as of another session."""
        self._connection.close()
        self._known.clear()

    def read(self, *names: str) -> list[Value]:
        """Read values one after the other, each as it is when it is asked for."""
        return [self._again(functools.partial(self._read, name)) for name in names]

    def _read(self, name: str) -> Value:
        dataref = self._dataref(name)
        value = self._ask('GET', f'{self._api}/datarefs/{dataref.id}/value')['data']
        if isinstance(value, str):
            return base64.b64decode(value).partition(b'\0')[0].decode('utf-8', 'replace')
        if isinstance(value, list) and dataref.element is None:
            return tuple(_finite(one) for one in value)
        return _finite(value if dataref.element is None else value[dataref.element])

    def write(self, name: str, value: float | tuple[float, ...]) -> None:
        """Set a dataref, or one element of an array."""
        self._again(lambda: self._write(name, value))

    def _write(self, name: str, value: float | tuple[float, ...]) -> None:
        dataref = self._dataref(name)
        if not dataref.writable:
            raise failed(InfraKind.PROTOCOL, f'{self.words}: {name} is read-only')
        change: Callable[[float], float] = round if dataref.type.startswith('int') else float
        number = [change(one) for one in value] if isinstance(value, tuple) else change(value)
        element = '' if dataref.element is None else f'?index={dataref.element}'
        self._ask(
            'PATCH', f'{self._api}/datarefs/{dataref.id}/value{element}', {'data': number}
        )

    def command(self, name: str) -> None:
        """Execute a command once; never sent twice."""
        split_name(name)
        ident = self._again(lambda: self._described('commands', name))['id']
        path = f'{self._api}/command/{ident}/activate'
        self._again(lambda: self._ask('POST', path, {'duration': 0}), tries=1)

    def trouble(self, name: str) -> str:
        """Why a dataref cannot be written; '' if it can."""
        try:
            dataref = self._again(lambda: self._dataref(name))
        except InfraError as error:
            if error.kind != InfraKind.PROTOCOL:
                raise
            return error.detail
        if not dataref.writable:
            return f'{self.words}: {name} is read-only'
        return f'{self.words}: {name} is text' if dataref.type == 'data' else ''

    def _dataref(self, name: str) -> Dataref:
        if name not in self._known:
            path, index = split_name(name)
            # X-Plane 11 has datarefs whose names end in an index; X-Plane 12 still knows them.
            answer = self._described('datarefs', name, optional=index is not None)
            if answer is None:
                answer = self._described('datarefs', path)
            else:
                index = None
            found = Dataref(
                answer['id'], str(answer['value_type']), bool(answer['is_writable']), index
            )
            if index is not None and not found.type.endswith('_array'):
                raise failed(
                    InfraKind.PROTOCOL, f'{self.words}: {path} is {found.type}, no array'
                )
            self._known[name] = found
        return self._known[name]

    def _described(self, kind: str, name: str, *, optional: bool = False) -> Any:
        path = f'{self._api}/{kind}?filter[name]={quote(name, safe="/")}'
        answer = self._ask('GET', path, optional=True)
        named = [
            one for one in (answer['data'] if answer else ())
            if one['name'] == name and isinstance(one['id'], int)
        ]
        if named or optional:
            return named[0] if named else None
        raise failed(
            InfraKind.PROTOCOL,
            f'{self.words}: X-Plane {self.version} has no {kind.removesuffix("s")} {name}',
        )

    def _again(self, ask: Callable[[], _T], *, tries: int | None = None) -> _T:
        """Ask; if the connection breaks, up to so many times."""
        tries = tries or self._tries
        trouble: Exception = TimeoutError()
        for _ in range(tries):
            try:
                return ask()
            except ConnectionRefusedError as error:
                raise failed(
                    InfraKind.DIED if self.version else InfraKind.NOT_READY,
                    f'{self.words}: nothing listens there; is X-Plane 12.1.4 or newer running?',
                ) from error
            except (OSError, http.client.HTTPException) as error:
                self.close()
                trouble = error
            except (LookupError, TypeError, ValueError, OverflowError) as error:
                raise failed(
                    InfraKind.PROTOCOL,
                    f'{self.words}: {self._asked} is answered by {self._answer!r:.120}',
                ) from error
        times = f'{tries} request{"s" if tries > 1 else ""} of {self._timeout_s:g} s'
        if isinstance(trouble, TimeoutError):
            raise failed(InfraKind.TIMEOUT, f'{self.words}: no answer after {times}') from trouble
        kind = InfraKind.DIED if isinstance(trouble, OSError) else InfraKind.PROTOCOL
        text = getattr(trouble, 'strerror', '') or type(trouble).__name__
        raise failed(kind, f'{self.words}: {text} after {times}') from trouble

    def _ask(
        self, method: str, path: str, content: Any = None, *, optional: bool = False
    ) -> Any:
        """The answer to one request, as JSON; None if it is optional and not there."""
        body = None if content is None else json.dumps(content).encode()
        self._connection.request(method, path, body, _HEADERS)
        response = self._connection.getresponse()
        data = response.read(_MOST_BYTES)
        self._asked, self._answer = path, data
        if response.status == 404 and optional:
            return None
        if response.status == 403:
            raise failed(
                InfraKind.NOT_READY, f'{self.words}: it refuses with {data!r:.120}; allow incoming '
                'traffic in its settings, Network'
            )
        if response.status != 200:
            raise failed(
                InfraKind.PROTOCOL,
                f'{self.words}: {method} {path}: {response.status} {data!r:.200}',
            )
        return load_json(data) if data else None


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(value)
    return number
