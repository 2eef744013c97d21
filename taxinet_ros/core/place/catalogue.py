"""Lookup of places, see :mod:`taxinet_ros.core.documents`."""

from __future__ import annotations

import os
import re
from functools import lru_cache
from pathlib import Path

from taxinet_ros.core.documents import Catalogue
from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.place_file import make_place, read_place
from taxinet_ros.core.place.random_place import PREFIX, random_place
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import Track
from taxinet_ros.errors import UsageError

SHIPPED_TRACKS = ('runway', 'exit_left', 'rapid_exit')
"""Tracks at the shipped places, see :class:`.track.Track`."""

_OF_AIRPORT = re.compile(
    r'(?:(.+\.dat(?:\.gz)?):)?([A-Za-z0-9]+)/([0-9]{1,2}[LCRlcr]?)(?:@(.+))?')
"""``FILE:ICAO/RUNWAY`` or ``ICAO/RUNWAY``, optionally with ``@ZONE``."""
_NO_RUNWAY = re.compile(r'(.+\.dat(?:\.gz)?)(?::([A-Za-z0-9]*)/?)?')
_RANDOM = re.compile(f'{PREFIX}([0-9]{{1,10}})')
_APT_DAT = (
    '/usr/share/games/flightgear/Airports/apt.dat.gz', '/usr/share/flightgear/Airports/apt.dat.gz',
    '~/X-Plane 12/Global Scenery/Global Airports/Earth nav data/apt.dat',
    '~/X-Plane 11/Custom Scenery/Global Airports/Earth nav data/apt.dat',
)
"""Where FlightGear and X-Plane put theirs."""


class Places(Catalogue[Place]):
    """Shipped places, YAML files, and airports of an apt.dat."""

    def typed(self, text: str) -> Place:
        """Find the place given by a user.

        Args:
            text: as for every catalogue; or ``apt.dat:ICAO/RUNWAY`` (with ``@ZONE`` for the time
                zone), or ``ICAO/RUNWAY`` of the apt.dat that ``TAXINET_APT_DAT`` names, or of an
                installed simulator's; or ``random:NUMBER`` (:mod:`.random_place`).

        Raises:
            UsageError: none of these, or an invalid file.
        """
        if airport := _OF_AIRPORT.fullmatch(text):
            path, icao, runway, zone = airport.groups(default='')
            path = path or _installed_apt_dat(text)
            return _place_of_airport(path, icao, runway, zone, _version(path))
        if without := _NO_RUNWAY.fullmatch(text):
            path, icao = without.groups(default='')
            if not icao:
                raise UsageError(f'place {text}: name an airport and a runway, as {path}:KSEA/16L')
            return _place_of_airport(path, icao, '', '', _version(path))  # raises: names them
        if number := _RANDOM.fullmatch(text):
            return self.find(random_place(int(number[1])).text)
        return super().typed(text)


PLACES = Places(
    'place', shipped=('kmwh_04', 'bikf_10', 'nzqn_05'), read=read_place, make=make_place,
    folder=Path(__file__).parent / 'shipped',
)
"""Grant County (the paper's), Keflavík and Queenstown; and the user's."""
SHIPPED_PLACES = PLACES.shipped
DEFAULT_PLACE = PLACES.default
find_place = PLACES.find
typed_place = PLACES.typed


@lru_cache(maxsize=64)
def find_track(place: str, track: str) -> Track:
    """The track of a scenario.

    Args:
        place: as for :func:`find_place`.
        track: its name there.

    Raises:
        UsageError: there is no such place, or no such track at it.
    """
    return find_place(place).track(track)


def load_place(word: str) -> str:
    """Load a place for a scenario: ``Scenario(place=load_place('mine.yaml'))``.

    Args:
        word: a shipped name, a YAML file, or ``apt.dat:ICAO/RUNWAY`` (docs/world.md).

    Raises:
        UsageError: none of these, or an invalid file.
    """
    return typed_place(str(word)).text


@lru_cache(maxsize=8)
def _place_of_airport(
    path: str, icao: str, runway: str, zone: str, version: tuple[int, ...]
) -> Place:
    # Imported here because it loads a library that is not needed for looking up places.
    from taxinet_ros.core.place.apt_dat import read_airport_place

    return find_place(read_airport_place(Path(path), icao, runway, zone).text)


def _installed_apt_dat(text: str) -> str:
    known = (os.path.expanduser(name) for name in _APT_DAT)
    found = os.getenv('TAXINET_APT_DAT') or next(filter(os.path.isfile, known), '')
    if not found:
        raise UsageError(
            f'place {text}: no apt.dat found; name one in TAXINET_APT_DAT, or as FILE.dat:{text}')
    return found


def _version(path: str) -> tuple[int, ...]:
    """What changes when a file is written again; empty if it cannot be read."""
    try:
        found = os.stat(path)
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def default_runway() -> Runway:
    """The runway of the paper, KMWH 04."""
    return find_place(DEFAULT_PLACE).runway
