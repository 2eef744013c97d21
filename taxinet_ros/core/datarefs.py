"""Values of X-Plane's own variables (*datarefs*) in a scenario, by their names.

A Scenic program sets them as the paper's do, ``param 'sim/weather/region/thermal_rate_ms' = 2``; a
YAML file under the key ``datarefs``. Only X-Plane has them; other worlds and cameras refuse them by
name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.core.documents import Catalogue, NamedDocument, canonical
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, read_yaml

NO_DATAREFS = 'none'
"""Name of the document without any."""
PREFIX = 'sim/'
"""What names of X-Plane's own datarefs and commands begin with."""
MOST_DATAREFS = 64
MOST_NAME = 255
"""Length limit of a name: XPlaneConnect counts it in a byte."""
MOST_ELEMENTS = 255
"""Length limit of an array that is written, for the same reason."""
MOST_NUMBER = 3.4e38
"""Greatest number that is written: X-Plane's floats have 32 bits."""

Number = float | tuple[float, ...]

_NAME = re.compile(r'([A-Za-z0-9_.\-]+(?:/[A-Za-z0-9_.\-]+)+)(?:\[(\d{1,4})\])?')


def split_name(text: str) -> tuple[str, int | None]:
    """Split ``sim/weather/cloud_type[0]`` into the name and the index of an element.

    Raises:
        UsageError: it is no name of a dataref or command.
    """
    found = _NAME.fullmatch(text)
    if not found or len(text) > MOST_NAME:
        raise UsageError(
            f'{text!r:.80} is no name of a dataref; expected words joined by /, as in '
            'sim/weather/rain_percent or sim/weather/cloud_type[0]'
        )
    return found[1], None if found[2] is None else int(found[2])


def checked_value(name: str, value: object) -> Number:
    """A number that 32 bits hold, or an array of them, to be written.

    Raises:
        UsageError: it is neither.
    """
    if isinstance(value, int | float) and abs(value) <= MOST_NUMBER:
        return float(value)
    if isinstance(value, Sequence) and not isinstance(value, str) and (
        0 < len(value) <= MOST_ELEMENTS
        and all(isinstance(one, int | float) and abs(one) <= MOST_NUMBER for one in value)
    ):
        return tuple(map(float, value))
    raise UsageError(
        f'{name} is {value!r:.60}; expected a finite number up to {MOST_NUMBER:g}, or a list of '
        f'1 to {MOST_ELEMENTS} of them'
    )


@dataclass(frozen=True, kw_only=True)
class Datarefs(NamedDocument):
    """Values of datarefs.

    Attributes:
        values: number or array by name.
    """

    values: Mapping[str, Number]


def make_datarefs(values: object, path: Path) -> Datarefs:
    """The datarefs that plain values stand for.

    Args:
        values: what a file holds: numbers or lists of numbers by name.
        path: of the file, for the messages.

    Raises:
        UsageError: a name or value is not as it should be.
    """
    top = Section(path, values)
    found: dict[str, Number] = {}
    for name in top:
        try:
            split_name(name)
            found[name] = checked_value(name, top.take(name, 'a number'))
        except UsageError as error:
            raise top.wrong(str(error)) from None
    if not found or len(found) > MOST_DATAREFS:
        raise top.wrong(f'expected 1 to {MOST_DATAREFS} datarefs, got {len(found)}')
    return Datarefs(name='datarefs', title='datarefs', document=canonical(found), values=found)


def refuse_datarefs(text: str, who: str) -> None:
    """Refuse a scenario's datarefs for what has none: they would have no effect.

    Args:
        text: the scenario's value.
        who: world or camera.

    Raises:
        UsageError: there are some.
    """
    if text != NO_DATAREFS:
        names = ', '.join(find_datarefs(text).values)
        raise UsageError(
            f'{who}: {names:.200} would have no effect; leave it out, or take X-Plane '
            '(camera xplane, world xplane)'
        )


def _read(path: Path, shipped: bool) -> Datarefs:
    if shipped:
        return Datarefs(
            name=NO_DATAREFS, title='no datarefs', document='{}', shipped=True, values={}
        )
    return make_datarefs(read_yaml(path, option='datarefs'), path)


DATAREF_SETS: Catalogue[Datarefs] = Catalogue(
    'datarefs', shipped=(NO_DATAREFS,), read=_read, make=make_datarefs, folder=Path(),
    one='datarefs',
)
"""None, and the user's."""
find_datarefs = DATAREF_SETS.find
