"""Reads places from user YAML files and from the JSON in scenarios.

Both are a mapping with the same keys (docs/world.md). Errors are one line with the file and the
key.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from taxinet_ros.core.documents import canonical, document_name
from taxinet_ros.core.place.markings import Polygon
from taxinet_ros.core.place.place import PaintedLine, Pavement, Place, TaxiRoute
from taxinet_ros.core.place.runway import (
    CATEGORIES,
    SURFACES,
    SURROUNDINGS,
    Condition,
    Crossing,
    Runway,
    time_zone,
)
from taxinet_ros.core.place.track import (
    LEAST_RADIUS_M,
    RUNWAY_TRACK,
    Track,
    check_room,
    make_track,
)
from taxinet_ros.files.plain_values import Section, read_yaml

_KEYS = ('name', 'title', 'icao', 'time_zone', 'runway', 'pavements', 'lines', 'routes', 'tracks')
_RUNWAY_KEYS = (
    'ends', 'width_m', 'elevation_m', 'length_m', 'bearing_deg', 'category', 'edge_stripes',
    'surface', 'surroundings', 'crossings', 'shoulder_m', 'condition',
)
_CONDITION = {
    'lightness': (0.7, 1.2), 'mottle': (0.0, 4.0), 'rubber': (0.0, 3.0), 'wear': (0.0, 3.0),
    'edge_wear': (0.0, 3.0), 'ground': (0.6, 1.3),
}
_MOST_SHOULDER_M = 20.0
_END_KEYS = ('designation', 'latitude_deg', 'longitude_deg', 'displaced_m')
_CROSSING_KEYS = ('x_m', 'yaw_deg', 'width_m', 'clear_half_m', 'paved_m')

LEAST_LENGTH_M, MOST_LENGTH_M = 700.0, 5500.0
LEAST_WIDTH_M, MOST_WIDTH_M = 15.0, 80.0
LEAST_TRACK_M = 7.5
"""Least width of a taxiway (ICAO Annex 14, 3.9.5, code A)."""
_LENGTH_SHARE, _BEARING_DEG = 0.005, 0.3
"""Tolerances of published length (relative) and bearing against those computed from the ends."""
_POLAR_DEG, _VARIATION_DEG = 65.0, 45.0
"""Most difference of a runway's number from its true bearing, and up to which latitude."""
_RADIUS_M, _FLATTENING = 6378137.0, 1 / 298.257223563
_CLEAR_M, _FILLET_M = 37.5, 85.0
"""Defaults: shoulder of a crossing runway, and length of the fillets beyond it."""
STEEPEST_DEG = 20.0
_FARTHEST_M = 50_000.0

_ICAO = re.compile(r'[A-Z0-9]{2,7}')
_DESIGNATION = re.compile(r'(0[1-9]|[12][0-9]|3[0-6])[LCR]?')


def read_place(path: Path, shipped: bool = False) -> Place:
    """Read the place of a YAML file.

    Raises:
        UsageError: an unreadable file, or an invalid value.
    """
    return make_place(read_yaml(path, option='place'), path, shipped=shipped)


def make_place(values: object, path: Path, *, shipped: bool = False) -> Place:
    """Build a place from plain values.

    Args:
        values: content of a place file.
        path: path of the file, for error messages.
        shipped: whether it is shipped with the package.

    Raises:
        UsageError: an invalid value.
    """
    top = Section(path, values, _KEYS)
    name = document_name(top, 'kmwh_04')
    zone = top.text('time_zone', kind='a time zone, such as Pacific/Auckland or UTC-08:00')
    try:
        time_zone(zone)
    except ValueError as error:
        raise top.wrong(str(error), 'time_zone') from None
    assert isinstance(values, Mapping)
    return Place(
        name=name,
        title=top.text('title', name, kind='a title'),
        icao=top.text('icao', '', kind='an ICAO code in capitals', matching=_ICAO),
        runway=_runway(top.section('runway', _RUNWAY_KEYS), zone),
        pavements=tuple(map(_pavement, top.sections('pavements', _PAVEMENT_KEYS, optional=True))),
        lines=tuple(map(_line, top.sections('lines', _LINE_KEYS, optional=True))),
        routes=tuple(map(_route, top.sections('routes', _ROUTE_KEYS, optional=True))),
        tracks=_tracks(top, checked=not shipped),
        document=canonical(values),
        shipped=shipped,
    )


def _runway(section: Section, zone: str) -> Runway:
    ends = section.sections('ends', _END_KEYS)
    if len(ends) != 2:
        raise section.wrong(f'expected two, the one taxied from first, got {len(ends)}', 'ends')
    near, far = (
        (one.number('latitude_deg', -85, 85), one.number('longitude_deg', -180, 180))
        for one in ends
    )
    elevation_m = section.number('elevation_m', -430, 5000)
    length_m, bearing_deg = _extent(section, near, far, elevation_m)
    designations = tuple(
        one.text(
            'designation', kind="a runway's number, such as '04' or '16R'", matching=_DESIGNATION
        ) for one in ends
    )
    if abs(int(designations[0][:2]) - int(designations[1][:2])) != 18:
        raise section.wrong(f'{designations[0]} and {designations[1]} are no opposite ends', 'ends')
    # Nearer to the poles, numbers follow no magnetic north.
    turn_deg = (bearing_deg - 10 * int(designations[0][:2]) + 180) % 360 - 180
    if abs(near[0]) <= _POLAR_DEG and abs(turn_deg) > _VARIATION_DEG:
        raise section.wrong(
            f'from {designations[0]} to {designations[1]} it is {bearing_deg:.0f} deg true, which '
            f'no runway {designations[0]} is; is an end, its latitude and longitude, or a sign '
            'swapped?', 'ends',
        )
    category = section.word('category', CATEGORIES)
    displaced = [one.number('displaced_m', 0, length_m / 3, default=0.0) for one in ends]
    return Runway(
        threshold_deg=near,
        end_deg=far,
        elevation_m=elevation_m,
        bearing_rad=math.radians(bearing_deg),
        length_m=length_m,
        width_m=section.number('width_m', LEAST_WIDTH_M, MOST_WIDTH_M),
        time_zone=zone,
        designations=(designations[0], designations[1]),
        displaced_m=(displaced[0], displaced[1]),
        category=category,
        edge_stripes=section.switch('edge_stripes', category == 'precision'),
        surface=section.word('surface', SURFACES),
        surroundings=section.word('surroundings', SURROUNDINGS, 'dry'),
        crossings=_crossings(section, length_m),
        shoulder_m=section.number('shoulder_m', 0.0, _MOST_SHOULDER_M, 0.0),
        condition=_condition(section),
    )


def _condition(section: Section) -> Condition:
    if 'condition' not in section:
        return Condition()
    given = section.section('condition', (*_CONDITION, 'seed'))
    numbers = {
        key: given.number(key, low, high)
        for key, (low, high) in _CONDITION.items() if key in given
    }
    return Condition(**numbers, seed=given.whole('seed', 0, 2**31 - 1) if 'seed' in given else 0)


def _extent(
    section: Section, near: tuple[float, float], far: tuple[float, float], elevation_m: float
) -> tuple[float, float]:
    """Length [m] and true bearing [deg]: as published, if close to those of the ends."""
    length_m, bearing_deg = _measured(near, far, elevation_m)
    if not LEAST_LENGTH_M <= length_m <= MOST_LENGTH_M:
        raise section.wrong(
            f'the ends are {length_m:.0f} m apart, '
            f'expected {LEAST_LENGTH_M:.0f} to {MOST_LENGTH_M:.0f} m', 'ends',
        )
    published_m = section.number('length_m', LEAST_LENGTH_M, MOST_LENGTH_M, length_m)
    if abs(published_m - length_m) > _LENGTH_SHARE * length_m:
        raise section.wrong(f'the ends are {length_m:.0f} m apart, not {published_m:g}', 'length_m')
    published_deg = section.number('bearing_deg', 0, 360, bearing_deg)
    if abs((published_deg - bearing_deg + 180) % 360 - 180) > _BEARING_DEG:
        raise section.wrong(
            f'from end to end it is {bearing_deg:.2f}, not {published_deg:g}', 'bearing_deg'
        )
    return published_m, published_deg


def _measured(
    near: tuple[float, float], far: tuple[float, float], elevation_m: float
) -> tuple[float, float]:
    """Distance between two points [m], and true bearing from the first to the second [deg].

    Mid-latitude formula with the WGS84 ellipsoid's radii of curvature; the error is below a
    centimetre for the length of a runway.
    """
    squared = _FLATTENING * (2 - _FLATTENING)
    middle = math.radians((near[0] + far[0]) / 2)
    share = 1 - squared * math.sin(middle) ** 2
    turn = math.radians((far[1] - near[1] + 180) % 360 - 180)
    north_m = math.radians(far[0] - near[0]) * (
        _RADIUS_M * (1 - squared) / share**1.5 + elevation_m
    )
    east_m = turn * math.cos(middle) * (_RADIUS_M / math.sqrt(share) + elevation_m)
    bearing = math.atan2(east_m, north_m) - turn * math.sin(middle) / 2
    return round(math.hypot(east_m, north_m), 3), round(math.degrees(bearing) % 360, 6)


def _crossings(section: Section, length_m: float) -> tuple[Crossing, ...]:
    entries = section.sections('crossings', _CROSSING_KEYS, optional=True)
    found = sorted(
        (_crossing(one, length_m) for one in entries), key=lambda crossing: crossing.x_m
    )
    for one, following in pairwise(found):
        if one.clear_x(0.0)[1] > following.clear_x(0.0)[0]:
            raise section.wrong(
                f'those at {one.x_m:g} m and {following.x_m:g} m overlap', 'crossings'
            )
    return tuple(found)


def _crossing(section: Section, length_m: float) -> Crossing:
    yaw_deg = section.number('yaw_deg', -180, 180)
    if abs(math.sin(math.radians(yaw_deg))) < math.sin(math.radians(STEEPEST_DEG)):
        raise section.wrong(
            f'expected an angle of {STEEPEST_DEG:.0f} deg or more to this runway, got {yaw_deg:g}',
            'yaw_deg',
        )
    width_m = section.number('width_m', 10, MOST_WIDTH_M)
    crossing = Crossing(
        x_m=section.number('x_m', 0, length_m),
        yaw_rad=math.radians(yaw_deg),
        width_m=width_m,
        clear_half_m=section.number('clear_half_m', width_m / 2, 150, width_m / 2 + _CLEAR_M),
        paved_m=(0.0, 0.0),
    )
    low, high = crossing.clear_x(0.0)
    first, last = section.numbers(
        'paved_m', 2, -1000, length_m + 1000, (low - _FILLET_M, high + _FILLET_M)
    )
    return replace(crossing, paved_m=(first, last))


_PAVEMENT_KEYS = ('surface', 'outline_m', 'holes_m')
_LINE_KEYS = ('style', 'points_m')
_ROUTE_KEYS = ('name', 'one_way', 'on_runway', 'points_m')
_TRACK_KEYS = ('name', 'title', 'width_m', 'painted', 'points_m', 'radius_m')


def _pavement(section: Section) -> Pavement:
    some = 'holes_m' in section and section.take('holes_m', 'a list of outlines') != []
    return Pavement(
        surface=section.word('surface', (*SURFACES, 'other')),
        outline=_points(section, 'outline_m', 3),
        holes=tuple(
            _points(hole, 'holes_m', 3) for hole in (section.several('holes_m') if some else ())
        ),
    )


def _line(section: Section) -> PaintedLine:
    return PaintedLine(
        style=section.whole('style', 0, 999), points=_points(section, 'points_m', 2)
    )


def _route(section: Section) -> TaxiRoute:
    return TaxiRoute(
        name=section.text('name', '', kind='a name', empty=True),
        one_way=section.switch('one_way', False),
        on_runway=section.switch('on_runway', False),
        points=_points(section, 'points_m', 2),
    )


def _tracks(top: Section, *, checked: bool) -> tuple[Track, ...]:
    found: dict[str, Track] = {}
    for section in top.sections('tracks', _TRACK_KEYS, optional=True):
        name = document_name(section, 'exit_left')
        if name in found or name == RUNWAY_TRACK:
            raise section.wrong(f'there is a track {name} already', 'name')
        found[name] = _track(section, name, checked=checked)
    return tuple(found.values())


def _track(section: Section, name: str, *, checked: bool) -> Track:
    points = _points(section, 'points_m', 2)
    width_m = section.number('width_m', LEAST_TRACK_M, MOST_WIDTH_M)
    try:
        track = make_track(
            name, section.text('title', name, kind='a title'), width_m, points,
            _radii(section, len(points) - 2),
            painted=section.switch('painted', True),
        )
        if checked:  # for shipped ones a test does it, once
            check_room(track)
    except ValueError as error:
        raise section.wrong(f'the track {error}', 'points_m') from None
    return track


def _radii(section: Section, corners: int) -> tuple[float, ...]:
    """Radius of the arc at each corner: one number for all, or a list."""
    if not corners:
        if 'radius_m' in section:
            raise section.wrong('has no effect: two points have no corner between them', 'radius_m')
        return ()
    if isinstance(section.take('radius_m', 'a number of metres'), list):
        return section.numbers('radius_m', corners, LEAST_RADIUS_M, _FARTHEST_M)
    return (section.number('radius_m', LEAST_RADIUS_M, _FARTHEST_M),) * corners


def _points(section: Section, key: str, least: int) -> Polygon:
    return tuple((x, y) for x, y in section.rows(key, 'x, y', _FARTHEST_M, least))
