"""Others on the ground from a user's YAML file, or from the JSON in scenarios (docs/world.md).

Their lookup is that of all :mod:`documents <taxinet_ros.core.documents>`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from taxinet_ros.core.documents import Catalogue
from taxinet_ros.core.traffic.traffic import (
    COLOURS,
    HOLD_LINE,
    KINDS,
    NOBODY,
    GroundObject,
    Leg,
    Size,
    Traffic,
    traffic_of,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, read_yaml

MOST_OBJECTS = 32
_MOST_LEGS = 50
_LEAST_SIZE_M, _MOST_SIZE_M = 0.1, 100.0
_LEAST_LEG_M = 0.01
_SPEEDS_MPS = (0.1, 30.0)
_LONGEST_WAIT_S = 3600.0
_WITHIN_M = (1.0, 1000.0)
_X_M, _Y_M = (-2000.0, 8000.0), (-3000.0, 3000.0)

_KEYS = (
    'kind', 'x_m', 'y_m', 'heading_deg', 'length_m', 'width_m', 'height_m', 'colour', 'wait_s',
    'path', 'until_s', 'stands_within_m', 'starts_within_m',
)
_MOVES = ('wait_s', 'stands_within_m', 'starts_within_m')
_LEG_KEYS = ('x_m', 'y_m', 'speed_mps', 'wait_s')
_FROM_SCENARIO = Path('traffic')


def make_traffic(values: object, path: Path) -> Traffic:
    """The objects that plain values stand for.

    Args:
        values: what a file holds.
        path: of the file, for the messages.

    Raises:
        UsageError: a value is not as it should be.
    """
    found = Section(path, values, ('objects',)).sections('objects', _KEYS, most=MOST_OBJECTS)
    return traffic_of([_object(one) for one in found])


def _object(section: Section) -> GroundObject:
    kind = section.word('kind', tuple(KINDS))
    known = KINDS[kind]
    if not known.solid:
        for key in ('height_m', 'path', *_MOVES):
            if key in section:
                raise section.wrong(f'{kind} lies on the ground; leave it out', key)
    for key in _MOVES:
        if key in section and 'path' not in section:
            raise section.wrong('has no effect without a path', key)
    if 'until_s' in section and kind != HOLD_LINE:
        raise section.wrong(f'only a {HOLD_LINE} is cleared, no {kind}; leave it out', 'until_s')
    size = Size(*(
        section.number(key, _LEAST_SIZE_M if usual else 0.0, _MOST_SIZE_M, usual)
        for key, usual in known.size._asdict().items()
    ))
    x_m, y_m = _place(section)
    return GroundObject(
        kind=kind, x_m=x_m, y_m=y_m,
        heading_deg=section.number('heading_deg', -360, 360, 0.0),
        size=size,
        colour=section.word('colour', COLOURS, known.colour),
        wait_s=section.number('wait_s', 0, _LONGEST_WAIT_S, 0.0),
        path=tuple(_legs(section, x_m, y_m)),
        stands_within_m=section.number('stands_within_m', *_WITHIN_M, 0.0),
        starts_within_m=section.number('starts_within_m', *_WITHIN_M, 0.0),
        until_s=section.number('until_s', 0, _LONGEST_WAIT_S, math.inf),
    )


def _legs(section: Section, x_m: float, y_m: float) -> Iterable[Leg]:
    for one in section.sections('path', _LEG_KEYS, optional=True, most=_MOST_LEGS):
        before = x_m, y_m
        x_m, y_m = _place(one)
        if math.dist(before, (x_m, y_m)) < _LEAST_LEG_M:
            raise one.wrong('it is there already; leave the point out')
        yield Leg(
            x_m=x_m, y_m=y_m, speed_mps=one.number('speed_mps', *_SPEEDS_MPS),
            wait_s=one.number('wait_s', 0, _LONGEST_WAIT_S, 0.0),
        )


def _place(section: Section) -> tuple[float, float]:
    return section.number('x_m', *_X_M), section.number('y_m', *_Y_M)


def _read(path: Path, shipped: bool) -> Traffic:
    if shipped:
        return traffic_of(())
    return make_traffic(read_yaml(path, option='traffic'), path)


OTHERS: Catalogue[Traffic] = Catalogue(
    'traffic', shipped=(NOBODY,), read=_read, make=make_traffic, folder=Path(),
    one='others on the ground',
)
"""Nobody, and the user's."""
find_traffic = OTHERS.find
typed_traffic = OTHERS.typed


def traffic_words(reference: str) -> str:
    """Number and kinds of the objects of a reference: ``2 cones and 1 hold line``.

    Without the kinds where only its digest is known.
    """
    try:
        return typed_traffic(reference).words
    except UsageError:
        number = reference.partition('_')[0]
        return f'{number} {"object" if number == "1" else "objects"}'


def load_traffic(source: str | Path | Sequence[Mapping[str, Any]]) -> str:
    """Load others on the ground for a scenario.

    ``Scenario(traffic=load_traffic([{'kind': 'vehicle', 'x_m': 450, 'y_m': 8}]))``

    Args:
        source: a YAML file, or the objects themselves with the keys of such a file
            (docs/world.md).

    Raises:
        UsageError: it is neither, or a value is not as it should be.
    """
    if isinstance(source, str | Path):
        return typed_traffic(str(source)).text
    objects = list(source) if isinstance(source, tuple) else source
    return make_traffic({'objects': objects}, _FROM_SCENARIO).text
