"""Client of X-Plane 12's web API: datarefs, commands and flights over REST.

The API came with X-Plane 12.1.1 (v1), commands and ``/api/capabilities`` with 12.1.4 (v2), flights
with 12.4.0 (v3). Ids of datarefs hold for one session of X-Plane. Values of the stream over
WebSocket are never used: they come ten times a second by the clock of the wall.

Source: "X-Plane local Web API" and "Flight Initialization API", developer.x-plane.com, as of
January 2026.
"""

from __future__ import annotations

import base64
import http.client
import json
import socket
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeGuard
from urllib.parse import quote

from taxinet_ros.core.datarefs import MOST_NUMBER, split_name
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.files.plain_values import load_json
from taxinet_ros.extras.limited_http import LimitedConnection
from taxinet_ros.extras.xplane.wire import Value, failed

PORT = 8086
VERSIONS = ('v3', 'v2', 'v1')
"""Versions of the API that the client speaks, the best first."""
_FIRST_VERSION = '12.1.1'
"""X-Plane 12.1.1 to 12.1.3 have v1 only, and nothing that tells the version."""
_HEADERS = {'Accept': 'application/json', 'Content-Type': 'application/json'}
_MOST_BYTES = 1 << 22
_NUMBERS = ('int', 'float', 'double')
_ARRAYS = ('int_array', 'float_array')
_TYPES = (*_NUMBERS, *_ARRAYS, 'data')
_MOST_INT = 2**31 - 1
_MOST_ID = 2**63


@dataclass(frozen=True, kw_only=True, slots=True)
class Dataref:
    """What the API tells about a dataref.

    Attributes:
        id: number in this session.
        name: its name, without the index of an element.
        type: of its values, as the API calls it.
        writable: whether it can be set.
        index: of the element that is meant; None for all of it.
    """

    id: int
    name: str
    type: str
    writable: bool
    index: int | None


class _RefusedError(Exception):
    """An answer other than 200.

    Attributes:
        status: of HTTP.
        code: ``error_code`` of the API, '' if it told none.
    """

    def __init__(self, status: int, code: str, text: str) -> None:
        super().__init__(text)
        self.status, self.code = status, code


class WebApi:
    """Client of one simulator's web API.

    Attributes:
        api: negotiated version of the API, ``v1``, ``v2`` or ``v3``.
    """

    def __init__(
        self, host: str, port: int = PORT, *, timeout_s: float = 3.0, tries: int = 3
    ) -> None:
        """Connect and agree on a version.

        Args:
            host: name or address of the simulator. X-Plane itself listens on its own machine only;
                from another one, a proxy or tunnel has to lead there.
            port: of the API (``--web_server_port`` of X-Plane).
            timeout_s: wait for each answer [s].
            tries: how often a request is sent.

        Raises:
            InfraError: nothing answers there, it is no X-Plane, or of an unknown version.
            UsageError: unknown host.
        """
        host = host.removeprefix('[').removesuffix(']') if ':' in host else host
        try:
            socket.getaddrinfo(host or 'no host', port, type=socket.SOCK_STREAM)
        except (OSError, TypeError, ValueError) as error:
            raise UsageError(f'x-plane: host {host!r:.80} is unknown') from error
        self._host, self._port = host, port
        self._timeout_s, self._tries = timeout_s, tries
        self.words = f'web API at {host}:{port}'
        self._connection: LimitedConnection | None = None
        self._known: dict[str, Dataref] = {}
        self._doubtful: set[str] = set()
        try:
            self.version, self.api = self._negotiate()
        except BaseException:
            self.close()
            raise
        self.words = f'web API {self.api} at {host}:{port}'

    def _negotiate(self) -> tuple[str, str]:
        try:
            told = self._request('GET', '/api/capabilities')
        except _RefusedError as error:
            if error.status != 404:
                raise self._failure(error) from error
            self._call('GET', '/api/v1/datarefs/count')
            return _FIRST_VERSION, 'v1'
        offered, version = _field(told, 'api', 'versions'), _field(told, 'x-plane', 'version')
        if not isinstance(offered, list) or not isinstance(version, str):
            raise self._malformed('/api/capabilities', told)
        common = [one for one in VERSIONS if one in offered]
        if not common:
            raise failed(
                InfraKind.PROTOCOL, f'{self.words}: X-Plane {version:.20} offers the versions '
                f'{offered!r:.60}; the client speaks {", ".join(VERSIONS)}'
            )
        return version, common[0]

    def read(self, *names: str) -> list[Value]:
        """Read values one after the other, each as it is when it is asked for.

        Raises:
            InfraError: no valid answer, no such dataref, or X-Plane was restarted meanwhile.
        """
        return [self._read(name) for name in names]

    def _read(self, name: str) -> Value:
        dataref = self._dataref(name)
        told = self._call('GET', f'/api/{self.api}/datarefs/{dataref.id}/value')
        self._dataref(name)  # if the connection broke meanwhile: was this its value?
        value = told.get('data') if isinstance(told, dict) else None
        if dataref.type in _NUMBERS and _finite(value):
            return float(value)
        if dataref.type in _ARRAYS and isinstance(value, list) and all(map(_finite, value)):
            if dataref.index is None:
                return tuple(map(float, value))
            if dataref.index < len(value):
                return float(value[dataref.index])
            raise failed(
                InfraKind.PROTOCOL, f'{self.words}: {dataref.name} has {len(value)} elements, '
                f'none of number {dataref.index}'
            )
        if dataref.type == 'data' and isinstance(value, str):
            try:
                data = base64.b64decode(value, validate=True)
                return data.partition(b'\0')[0].decode('utf-8', 'replace')
            except ValueError:
                pass
        raise self._malformed(f'{dataref.name} ({dataref.type})', told)

    def write(self, name: str, value: float | tuple[float, ...]) -> None:
        """Set a dataref, or one element of an array.

        Raises:
            InfraError: it was refused: no such dataref, read-only, of another size, or greater than
                its type can hold.
        """
        dataref = self._dataref(name)
        if not dataref.writable:
            raise failed(InfraKind.PROTOCOL, f'{self.words}: {name} is read-only')
        most = _MOST_INT if dataref.type in ('int', 'int_array') else MOST_NUMBER
        if not all(abs(one) <= most for one in (value if isinstance(value, tuple) else (value,))):
            raise failed(
                InfraKind.PROTOCOL, f'{self.words}: {name} ({dataref.type}) cannot be {value!r:.40}'
            )
        number: Any = value
        if dataref.type in ('int', 'int_array'):
            number = [round(one) for one in value] if isinstance(value, tuple) else round(value)
        elif isinstance(value, tuple):
            number = list(value)
        path = f'/api/{self.api}/datarefs/{dataref.id}/value'
        if dataref.index is not None:
            path += f'?index={dataref.index}'
        self._call('PATCH', path, {'data': number})
        self._dataref(name)

    def command(self, name: str) -> None:
        """Execute a command once; never sent twice.

        Raises:
            InfraError: no such command, or API v1, which has none.
        """
        split_name(name)
        if self.api == 'v1':
            raise failed(
                InfraKind.PROTOCOL, f'{self.words}: {name}: commands need API v2 (X-Plane 12.1.4)'
            )
        ident = _field(self._find('commands', name), 'id')
        self._call(
            'POST', f'/api/{self.api}/command/{self._number(ident, name)}/activate', {'duration': 0}
        )

    def update_flight(self, changes: Mapping[str, Any]) -> None:
        """Change the running flight, as time and weather, in the words of X-Plane's flight API.

        Raises:
            InfraError: it was refused, or the API is older than v3.
        """
        self._flight('PATCH', changes)

    def start_flight(self, flight: Mapping[str, Any]) -> None:
        """Begin another flight; X-Plane may take minutes to load it. Never sent twice.

        Raises:
            InfraError: it was refused, or the API is older than v3.
        """
        self._flight('POST', flight)

    def _flight(self, method: str, content: Mapping[str, Any]) -> None:
        if self.api != 'v3':
            raise failed(
                InfraKind.PROTOCOL, f'{self.words}: flights need API v3 (X-Plane 12.4.0)'
            )
        self._call(method, '/api/v3/flight', {'data': dict(content)})

    def trouble(self, name: str) -> str:
        """Why a dataref cannot be written; '' if it can."""
        try:
            dataref = self._dataref(name)
        except InfraError as error:
            if error.kind != InfraKind.PROTOCOL:
                raise
            return error.detail
        if not dataref.writable:
            return f'{self.words}: {name} is read-only'
        return f'{self.words}: {name} is text' if dataref.type == 'data' else ''

    def close(self) -> None:
        """Close the connection."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _dataref(self, name: str) -> Dataref:
        if name not in self._known:
            self._known[name] = self._look_up(name)
        while name in self._doubtful:
            self._doubtful.discard(name)  # asking may break the connection once more
            if self._look_up(name) != self._known[name]:
                raise failed(
                    InfraKind.DIED, f'{self.words}: {name} has another id since the connection '
                    'broke; X-Plane was restarted during the run'
                )
        return self._known[name]

    def _look_up(self, name: str) -> Dataref:
        path, index = split_name(name)
        # X-Plane 11 has datarefs whose names end in an index; X-Plane 12 still knows them.
        found = self._find('datarefs', name, optional=index is not None)
        if found is None:
            found = self._find('datarefs', path)
        else:
            index = None
        kind, writable = found.get('value_type'), found.get('is_writable')
        if kind not in _TYPES or not isinstance(writable, bool):
            raise self._malformed(name, found)
        if index is not None and kind not in _ARRAYS:
            raise failed(InfraKind.PROTOCOL, f'{self.words}: {path} is {kind}, no array')
        return Dataref(
            id=self._number(found.get('id'), name), name=path, type=kind, writable=writable,
            index=index,
        )

    def _find(self, kind: str, name: str, *, optional: bool = False) -> Any:
        path = f'/api/{self.api}/{kind}?filter[name]={quote(name, safe="/")}'
        try:
            told = self._request('GET', path)
        except _RefusedError as error:
            if error.status != 404:
                raise self._failure(error) from error
            told = {'data': []}
        found = told.get('data') if isinstance(told, dict) else None
        if not isinstance(found, list) or any(not isinstance(one, dict) for one in found):
            raise self._malformed(path, told)
        named = [one for one in found if one.get('name') == name]
        if named:
            return named[0]
        if optional:
            return None
        raise failed(
            InfraKind.PROTOCOL,
            f'{self.words}: X-Plane {self.version} has no {kind.removesuffix("s")} {name}',
        )

    def _number(self, ident: object, name: str) -> int:
        # More than 32 bits.
        if isinstance(ident, int) and not isinstance(ident, bool) and 0 <= ident < _MOST_ID:
            return ident
        raise self._malformed(f'the id of {name}', ident)

    def _call(self, method: str, path: str, content: Any = None) -> Any:
        try:
            return self._request(method, path, content)
        except _RefusedError as error:
            raise self._failure(error) from error

    def _failure(self, error: _RefusedError) -> Exception:
        kind = InfraKind.PROTOCOL
        text = f'{self.words}: {error}'
        if error.code in ('invalid_dataref_id', 'invalid_command_id'):
            return failed(InfraKind.DIED, f'{text}; X-Plane was restarted during the run')
        if error.status == 403 and error.code != 'dataref_is_readonly':
            kind = InfraKind.NOT_READY
            text += '; allow incoming traffic in its settings, Network'
        return failed(kind, text)

    def _request(self, method: str, path: str, content: Any = None) -> Any:
        body = None if content is None else json.dumps(content, allow_nan=False).encode()
        tries = self._tries
        if method == 'POST':  # on a new connection: an idle one may be closed when it is sent
            self.close()
            tries = 1
        trouble: Exception = TimeoutError()
        for _ in range(tries):
            try:
                return self._exchange(method, path, body)
            except ConnectionRefusedError as error:
                raise failed(
                    InfraKind.DIED if self._known else InfraKind.NOT_READY,
                    f'{self.words}: nothing listens there; is X-Plane 12.1.1 or newer running?',
                ) from error
            except (OSError, http.client.HTTPException) as error:
                self.close()
                # Who answers next may be another session, with other datarefs of these ids.
                self._doubtful = set(self._known)
                trouble = error
        raise self._broken(trouble, tries) from trouble

    def _broken(self, error: Exception, tries: int) -> Exception:
        after = f'after {tries} request{"s" if tries > 1 else ""}'
        if isinstance(error, TimeoutError):
            return failed(
                InfraKind.TIMEOUT,
                f'{self.words}: no answer {after} of {self._timeout_s:g} s; is it still loading?',
            )
        if isinstance(error, http.client.HTTPException) and not isinstance(
            error, http.client.RemoteDisconnected
        ):
            return failed(
                InfraKind.PROTOCOL, f'{self.words}: {type(error).__name__} {after}; no valid HTTP'
            )
        text = getattr(error, 'strerror', None) or str(error)
        return failed(InfraKind.DIED, f'{self.words}: {text} {after}')

    def _exchange(self, method: str, path: str, body: bytes | None) -> Any:
        if self._connection is None:
            self._connection = LimitedConnection(
                self._host, self._port, timeout=self._timeout_s
            )
        self._connection.request(method, path, body, _HEADERS)
        response = self._connection.getresponse()
        data = response.read(_MOST_BYTES + 1)
        if len(data) > _MOST_BYTES:
            self.close()
            raise failed(InfraKind.PROTOCOL, f'{self.words}: {path} has more than 4 MiB')
        if response.length:
            raise http.client.IncompleteRead(data, response.length)
        try:
            told = load_json(data) if data else None
        except ValueError:
            if response.status == 200:
                raise self._malformed(path, data) from None
            told = None
        if response.status != 200:
            code, text = (_field(told, f'error_{one}') for one in ('code', 'message'))
            words = f'{method} {path.partition("?")[0]}: {response.status}'
            more = ' '.join(f'{one:.200}' for one in (code, text) if isinstance(one, str))
            raise _RefusedError(
                response.status, code if isinstance(code, str) else '', f'{words} {more}'.strip()
            )
        return told

    def _malformed(self, what: str, told: object) -> InfraError:
        return failed(InfraKind.PROTOCOL, f'{self.words}: {what} is answered by {told!r:.120}')


def _field(value: Any, *path: str) -> Any:
    for key in path:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _finite(value: object) -> TypeGuard[int | float]:
    return (
        isinstance(value, int | float) and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max  # a whole number may be longer than any float
    )
