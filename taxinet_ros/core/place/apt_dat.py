"""Reads places from a user's ``apt.dat`` of X-Plane or FlightGear.

Format: X-Plane airport data, versions 1000 to 1200 (developer.x-plane.com). The reader uses rows 1
(land airport), 100 (runway), 110 to 116 (pavements and their nodes), 120 (painted lines), 1201 and
1202 (taxi routes) and ignores others. The global file has 350 MB: it is memory-mapped and searched
for the requested airport; only that part is parsed.
"""

from __future__ import annotations

import functools
import gzip
import math
import mmap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, ClassVar

from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.place_file import STEEPEST_DEG, make_place
from taxinet_ros.core.place.runway_frame import GeodeticPose, RunwayFrame
from taxinet_ros.core.types import FOOT_M
from taxinet_ros.errors import UsageError, warn_once
from taxinet_ros.files.reading import open_regular

VERSIONS = range(1000, 1201)

_AIRPORT, _END = (b'1', b'16', b'17'), b'99'
_CHUNK = 1 << 24
_CURVE_STEPS = 8
_MAX_LINE_BYTES = 1 << 16
"""Longest row of a packed file; those of X-Plane have less than 200 bytes."""
"""Number of line segments per curve."""
_CATEGORIES = {
    0: 'visual', 1: 'visual', 2: 'nonprecision', 3: 'precision', 4: 'nonprecision',
    5: 'precision', 6: 'nonprecision', 7: 'precision',
}
"""Category by runway marking code: none, visual, then FAA, UK and EASA markings."""
_ASPHALT, _CONCRETE = (1, *range(20, 39)), (2, *range(50, 58))
"""Surface codes; version 1200 adds shades of both."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Row:
    """One row: its number in the file (from 1), its code, and the remaining words."""

    number: int
    code: int
    words: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class _End:
    number: str
    position_deg: Point
    displaced_m: float
    markings: int


@dataclass(frozen=True, kw_only=True, slots=True)
class _RunwayRow:
    row: _Row
    width_m: float
    surface: int
    ends: tuple[_End, _End]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Node:
    """A node of a contour, with its control point and the type of the line after it."""

    at: Point
    control: Point | None
    style: int


@dataclass(slots=True)
class _Airport:
    """Parsed rows of an airport, coordinates in degrees."""

    icao: str
    title: str
    elevation_m: float
    runways: list[_RunwayRow] = field(default_factory=list)
    areas: list[tuple[int, list[list[Point]]]] = field(default_factory=list)
    lines: list[tuple[int, list[Point]]] = field(default_factory=list)
    nodes: dict[str, Point] = field(default_factory=dict)
    edges: list[tuple[str, str, bool, bool, str]] = field(default_factory=list)


def read_airport_place(path: Path, icao: str, runway: str, time_zone: str = '') -> Place:
    """Read the place of one runway of an airport; the named end is the origin.

    Args:
        path: an ``apt.dat`` or ``apt.dat.gz``.
        icao: the airport's identifier.
        runway: designation of the end, such as ``04`` or ``16R``.
        time_zone: IANA name; '': whole hours from the longitude, because the file has no time zone.

    Raises:
        UsageError: the file is unreadable or of another format, has no such airport or runway, or
            has an invalid row.
    """
    airport = _Reader(path).airport(icao.upper())
    wanted = runway.upper().zfill(3 if runway[-1:].isalpha() else 2)
    found = [
        (one, end) for one in airport.runways for end in (0, 1) if one.ends[end].number == wanted
    ]
    if not found:
        known = ', '.join(end.number for one in airport.runways for end in one.ends)
        what = f'has no runway {runway!r}' if runway else 'needs a runway, as in KSEA/16L'
        raise UsageError(f'{path}: {airport.icao} {what}; it has {known}')
    row, end = found[0]
    where = f'{path}: row {row.row.number}'
    if row.ends[0].position_deg == row.ends[1].position_deg:
        raise UsageError(f'{where}: both ends are at the same point')
    if _surface_word(row.surface) == 'other':
        raise UsageError(
            f'{where}: the surface {row.surface} is neither asphalt nor concrete, and has no paint'
        )
    document = _document(airport, row, end, time_zone)
    code, category = _markings(row), document['runway']['category']
    if not code or code not in _CATEGORIES:
        warn_once(
            f'{where}: markings of code {code}, {"unknown" if code else "none"}; the runway is '
            f'painted as {category}'
        )
    return make_place(document, Path(where))


class _Reader:
    """Reads one airport from a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def airport(self, icao: str) -> _Airport:
        """Parse an airport, selected by identifier."""
        try:
            rows = list(self._rows(icao))
        except (OSError, EOFError) as error:
            what = getattr(error, 'strerror', None) or str(error)
            raise UsageError(f'{self._path}: cannot be read: {what}') from None
        if not rows:
            raise UsageError(f'{self._path}: has no airport {icao}')
        first = rows[0]
        words = first.words
        airport = _Airport(
            icao=icao, title=' '.join(words[4:]) or icao,
            elevation_m=round(self._number(first, 0, 'elevation') * FOOT_M, 2),
        )
        self._take(airport, rows[1:])
        return airport

    def _wrong(self, row: _Row, what: str) -> UsageError:
        return UsageError(f'{self._path}: row {row.number}: {what}')

    def _rows(self, icao: str) -> Iterator[_Row]:
        """Rows of an airport, from its row 1 on; none if it is not in the file."""
        if self._path.suffix == '.gz':
            with open_regular(self._path) as file, gzip.open(file, 'rb') as stream:
                yield from self._section(enumerate(self._lines(stream), start=1), icao)
            return
        with open_regular(self._path) as file:
            if not self._path.stat().st_size:
                raise UsageError(f'{self._path}: is empty')
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as whole:
                self._check_header([whole.readline(), whole.readline()])
                start = _start_of(whole, icao.encode())
                if start < 0:
                    return
                whole.seek(start)
                first = _lines_before(whole, start) + 1
                lines = enumerate(iter(whole.readline, b''), start=first)
                yield from self._of_airport(lines)

    def _lines(self, stream: gzip.GzipFile) -> Iterator[bytes]:
        """Lines of an unpacked file, which may be one without an end."""
        for line in iter(functools.partial(stream.readline, _MAX_LINE_BYTES), b''):
            if len(line) == _MAX_LINE_BYTES:
                raise UsageError(f'{self._path}: a row has more than {_MAX_LINE_BYTES >> 10} KiB')
            yield line

    def _section(self, lines: Iterator[tuple[int, bytes]], icao: str) -> Iterator[_Row]:
        """Rows of an airport from a stream of lines, read once."""
        self._check_header([line for _, line in (next(lines, (0, b'')), next(lines, (0, b'')))])
        wanted = icao.encode()
        for number, line in lines:
            words = line.split(None, 5)
            if line.startswith(_AIRPORT) and len(words) > 4 and words[4] == wanted:
                yield from self._of_airport(_chained((number, line), lines))
                return

    def _check_header(self, lines: list[bytes]) -> None:
        origin, version = (line.strip() for line in lines)
        word = version.split(None, 1)[:1]
        if origin not in (b'I', b'A') or not word or not word[0].isdigit():
            raise UsageError(
                f'{self._path}: row 1: no apt.dat, which begins with I or A and its version'
            )
        if int(word[0]) not in VERSIONS:
            raise UsageError(
                f'{self._path}: row 2: version {int(word[0])}; read are {VERSIONS[0]} to '
                f'{VERSIONS[-1]}'
            )

    def _of_airport(self, lines: Iterable[tuple[int, bytes]]) -> Iterator[_Row]:
        for count, (number, line) in enumerate(lines):
            words = line.split()
            if count and words and (words[0] in _AIRPORT or words[0] == _END):
                return
            if not words:
                continue
            text = tuple(word.decode('utf-8', 'replace') for word in words)
            if not text[0].isdecimal():
                raise self._wrong(_Row(number, 0, ()), f'no row code: {text[0]!r:.40}')
            yield _Row(number, int(text[0]), text[1:])

    def _take(self, airport: _Airport, rows: list[_Row]) -> None:
        """Process the rows of an airport by their code."""
        inside: tuple[_Row, list[_Row]] | None = None
        for row in rows:
            if 111 <= row.code <= 116:
                if inside is not None:
                    inside[1].append(row)
                continue
            self._take_shape(airport, inside)
            inside = (row, []) if row.code in (110, 120) else None
            if take := self._takers.get(row.code):
                take(self, airport, row)
        self._take_shape(airport, inside)

    def _runway(self, airport: _Airport, row: _Row) -> None:
        if len(row.words) < 25:
            raise self._wrong(row, f'a runway has 25 values or more, here are {len(row.words)}')
        near, far = (
            _End(
                number=row.words[at].zfill(3 if row.words[at][-1].isalpha() else 2),
                position_deg=self._position(row, at + 1),
                displaced_m=self._number(row, at + 3, 'displaced threshold'),
                markings=self._code(row, at + 5, 'markings'),
            )
            for at in (7, 16)
        )
        airport.runways.append(_RunwayRow(
            row=row, width_m=self._number(row, 0, 'width'), surface=self._code(row, 1, 'surface'),
            ends=(near, far),
        ))

    def _route_node(self, airport: _Airport, row: _Row) -> None:
        if len(row.words) < 4:
            raise self._wrong(row, f'a node of a route has 4 values, here are {len(row.words)}')
        airport.nodes[row.words[3]] = self._position(row, 0)

    def _route_edge(self, airport: _Airport, row: _Row) -> None:
        if len(row.words) < 3:
            raise self._wrong(row, f'a taxi route has 3 values, here are {len(row.words)}')
        kind = row.words[3] if len(row.words) > 3 else ''
        airport.edges.append((
            row.words[0], row.words[1], row.words[2] == 'oneway', kind == 'runway',
            ' '.join(row.words[4:]),
        ))

    _takers: ClassVar[dict[int, Callable[[_Reader, _Airport, _Row], None]]] = {
        100: _runway, 1201: _route_node, 1202: _route_edge,
    }

    def _take_shape(self, airport: _Airport, shape: tuple[_Row, list[_Row]] | None) -> None:
        if shape is None:
            return
        head, rows = shape
        outlines = []
        for contour, closed in self._contours(rows):
            airport.lines += _lines(contour, closed=closed)
            nodes = [(node.at, node.control) for node in contour]
            if closed and len(outline := _flattened(nodes, closed=True)) > 2:
                outlines.append(outline)
        if head.code == 110 and outlines:
            airport.areas.append((self._code(head, 0, 'surface'), outlines))

    def _contours(self, rows: list[_Row]) -> Iterator[tuple[list[_Node], bool]]:
        """Contours of node rows, and whether each is closed."""
        nodes: list[_Node] = []
        for row in rows:
            curved = row.code in (112, 114, 116)
            # Line types are below 100, types of lights above.
            more = [int(word) for word in row.words[4 if curved else 2:][:2] if word.isdecimal()]
            nodes.append(_Node(
                at=self._position(row, 0), control=self._position(row, 2) if curved else None,
                style=next((one for one in more if one < 100), 0),
            ))
            if row.code in (113, 114, 115, 116):
                yield nodes, row.code in (113, 114)
                nodes = []

    def _position(self, row: _Row, at: int) -> Point:
        latitude, longitude = (self._number(row, at + k, 'a coordinate') for k in (0, 1))
        if not (abs(latitude) <= 90 and abs(longitude) <= 180):
            raise self._wrong(row, f'no position on the Earth: {latitude:g} {longitude:g}')
        return latitude, longitude

    def _number(self, row: _Row, at: int, what: str) -> float:
        text = row.words[at] if at < len(row.words) else 'nothing'
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise self._wrong(row, f'{what}: expected a number, got {text!r:.40}')
        return number

    def _code(self, row: _Row, at: int, what: str) -> int:
        return int(self._number(row, at, what))


def _start_of(whole: mmap.mmap, icao: bytes) -> int:
    """Offset of an airport's row, or -1."""
    at = -1
    while (at := whole.find(b' ' + icao, at + 1)) >= 0:
        start = whole.rfind(b'\n', 0, at) + 1
        words = whole[start:at + len(icao) + 2].split()
        if len(words) == 5 and words[0] in _AIRPORT and words[4] == icao:
            return start
    return -1


def _lines_before(whole: mmap.mmap, end: int) -> int:
    """Number of lines before an offset."""
    return sum(
        whole[at:min(at + _CHUNK, end)].count(b'\n') for at in range(0, end, _CHUNK)
    )


def _chained(
    first: tuple[int, bytes], others: Iterator[tuple[int, bytes]]
) -> Iterator[tuple[int, bytes]]:
    yield first
    yield from others


def _lines(nodes: list[_Node], *, closed: bool) -> Iterator[tuple[int, list[Point]]]:
    """Painted lines of a contour: type and points. A node has the type of what follows it."""
    pairs = list(pairwise([*nodes, nodes[0]] if closed else nodes))
    for style, group in groupby(pairs, key=lambda pair: pair[0].style):
        ends = [pair for pair in group if pair[0].at != pair[1].at]
        if style and ends:
            line = [ends[0][0], *(end for _, end in ends)]
            yield style, _flattened([(node.at, node.control) for node in line], closed=False)


def _flattened(nodes: list[tuple[Point, Point | None]], *, closed: bool) -> list[Point]:
    """Polyline through nodes with control points; curves become short segments."""
    found = [nodes[0][0]]
    pairs = list(pairwise(nodes))
    if closed and len(nodes) > 1:
        pairs.append((nodes[-1], nodes[0]))
    for (start, leaving), (end, beyond) in pairs:
        # The control point is for the outgoing curve; the incoming one uses its mirror image.
        arriving = None if beyond is None else (2 * end[0] - beyond[0], 2 * end[1] - beyond[1])
        controls = [control for control in (leaving, arriving) if control is not None]
        steps = _CURVE_STEPS if controls else 1
        found += [_bezier([start, *controls, end], step / steps) for step in range(1, steps + 1)]
    return found[:-1] if closed and len(found) > 1 else found


def _bezier(points: list[Point], share: float) -> Point:
    """Point of a Bézier curve (de Casteljau)."""
    while len(points) > 1:
        points = [
            (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))
            for a, b in pairwise(points)
        ]
    return points[0]


def _document(airport: _Airport, row: _RunwayRow, end: int, time_zone: str) -> dict[str, Any]:
    """Keys and values of the place, as in a place file."""
    near, far = row.ends[end], row.ends[1 - end]
    frame = RunwayFrame(near.position_deg, far.position_deg, airport.elevation_m)

    def in_map(point: Point) -> list[float]:
        pose = frame.to_map(GeodeticPose(
            latitude_rad=math.radians(point[0]), longitude_rad=math.radians(point[1]),
            altitude_m=airport.elevation_m, heading_rad=0.0,
        ))
        return [round(pose.x_m, 2), round(pose.y_m, 2)]

    def along(points: list[Point]) -> list[list[float]]:
        return [in_map(point) for point in points]

    hours = round(near.position_deg[1] / 15)
    crossings = [
        crossing for other in airport.runways if other is not row
        for crossing in _crossing(other, row, in_map, frame.length_m)
    ]
    ground = {
        'pavements': [
            {
                'surface': _surface_word(surface), 'outline_m': along(outlines[0]),
                'holes_m': [along(hole) for hole in outlines[1:]],
            }
            for surface, outlines in airport.areas
        ] + [_as_pavement(other, in_map) for other in airport.runways if other is not row],
        'lines': [{'style': style, 'points_m': along(points)} for style, points in airport.lines],
        'routes': [
            {
                'name': name, 'one_way': one_way, 'on_runway': on_runway,
                'points_m': along([airport.nodes[start], airport.nodes[stop]]),
            }
            for start, stop, one_way, on_runway, name in airport.edges
            if start in airport.nodes and stop in airport.nodes
        ],
    }
    return {
        'name': f'{_plain(airport.icao)}_{near.number.lower()}',
        'title': f'{airport.title} ({airport.icao}) runway {near.number}',
        'icao': airport.icao,
        'time_zone': time_zone or f'UTC{hours:+03d}:00',
        'runway': {
            'ends': [
                {
                    'designation': one.number, 'latitude_deg': one.position_deg[0],
                    'longitude_deg': one.position_deg[1], 'displaced_m': one.displaced_m,
                }
                for one in (near, far)
            ],
            'width_m': row.width_m,
            'elevation_m': airport.elevation_m,
            'category': _CATEGORIES.get(_markings(row), 'precision'),
            'surface': _surface_word(row.surface),
            **({'crossings': crossings} if crossings else {}),
        },
        **{key: entries for key, entries in ground.items() if entries},
    }


def _markings(row: _RunwayRow) -> int:
    return max(end.markings for end in row.ends)


def _crossing(
    other: _RunwayRow, row: _RunwayRow, in_map: Callable[[Point], list[float]], length_m: float
) -> Iterator[dict[str, Any]]:
    """Entry for another runway that crosses this one and is at least as wide."""
    (x0, y0), (x1, y1) = (in_map(end.position_deg) for end in other.ends)
    if other.width_m < row.width_m or y0 * y1 >= 0:
        return
    x_m = x0 + (x1 - x0) * y0 / (y0 - y1)
    yaw_deg = math.degrees(math.atan2(y1 - y0, x1 - x0))
    steep = abs(math.sin(math.radians(yaw_deg))) > math.sin(math.radians(STEEPEST_DEG))
    if 0 < x_m < length_m and steep:
        yield {'x_m': round(x_m, 1), 'yaw_deg': round(yaw_deg, 2), 'width_m': other.width_m}


def _as_pavement(other: _RunwayRow, in_map: Callable[[Point], list[float]]) -> dict[str, Any]:
    """Pavement entry for another runway of the airport."""
    (x0, y0), (x1, y1) = (in_map(end.position_deg) for end in other.ends)
    share = other.width_m / 2 / max(math.hypot(x1 - x0, y1 - y0), 1.0)
    dx, dy = share * (y0 - y1), share * (x1 - x0)
    corners = ((x0 + dx, y0 + dy), (x1 + dx, y1 + dy), (x1 - dx, y1 - dy), (x0 - dx, y0 - dy))
    return {
        'surface': _surface_word(other.surface),
        'outline_m': [[round(x, 2), round(y, 2)] for x, y in corners],
    }


def _surface_word(code: int) -> str:
    return 'asphalt' if code in _ASPHALT else 'concrete' if code in _CONCRETE else 'other'


def _plain(text: str) -> str:
    """Convert an airport identifier to the start of a place's name."""
    plain = ''.join(sign for sign in text.lower() if sign.isalnum() and sign.isascii())
    return plain if plain[:1].isalpha() else f'a{plain}'
