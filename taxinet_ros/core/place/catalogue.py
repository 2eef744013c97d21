"""Lookup of places: shipped ones, ones from files, and ones already loaded in this process.

A scenario contains a shipped name or the whole place as JSON, so messages, bags and other processes
need no file. Tables contain the short reference ``NAME@DIGEST``; the whole place is stored once in
the campaign's ledger, and the reference resolves after that has been read.
"""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.place_file import place_from_document, read_place
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import Track
from taxinet_ros.errors import UsageError

DEFAULT_PLACE = 'kmwh_04'
SHIPPED_PLACES = ('kmwh_04', 'bikf_10', 'nzqn_05')
"""Grant County (the paper's), Keflavík and Queenstown."""

SHIPPED_TRACKS = ('runway', 'exit_left', 'rapid_exit')
"""Tracks at them, see :class:`.track.Track`."""

_FOLDER = Path(__file__).parent / 'shipped'
_REFERENCE = re.compile(r'[a-z][a-z0-9_]*@[0-9a-f]{12}')
_SUFFIXES = ('.yaml', '.yml')
_OF_AIRPORT = re.compile(r'(.+\.dat(?:\.gz)?):([A-Za-z0-9]+)/([0-9]{1,2}[LCRlcr]?)(?:@(.+))?')
"""``FILE:ICAO/RUNWAY``, optionally with ``@ZONE``."""
_known: dict[str, Place] = {}
"""Loaded places by reference; references are content hashes, so entries never change."""


@lru_cache(maxsize=64)
def find_place(text: str) -> Place:
    """Find the place of a scenario by a shipped name or by its JSON.

    Raises:
        UsageError: unknown name, or invalid JSON.
    """
    if text.startswith('{'):
        place = place_from_document(text)
        _known[place.reference] = place
        return place
    if text in SHIPPED_PLACES:
        return read_place(_FOLDER / f'{text}.yaml', shipped=True)
    raise UsageError(
        f'scenario: place is {text!r:.60}, not one of {", ".join(SHIPPED_PLACES)}, '
        'nor a YAML file of a place (in Python: load_place)'
    )


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


def typed_place(text: str) -> Place:
    """Find the place given by a user.

    Args:
        text: a shipped name, a YAML file, ``apt.dat:ICAO/RUNWAY`` (with ``@ZONE`` for the time
            zone), or a reference from a table.

    Raises:
        UsageError: none of these, or an invalid file.
    """
    if airport := _OF_AIRPORT.fullmatch(text):
        return _place_of_airport(*airport.groups(default=''))
    if text.lower().endswith(_SUFFIXES):
        return find_place(read_place(Path(text)).text)
    if _REFERENCE.fullmatch(text):
        if text not in _known:
            raise UsageError(
                f'scenario: place {text} is known by its digest only; the whole of it is in the '
                'ledger of its campaign, and in the bags of its runs'
            )
        return _known[text]
    return find_place(text)


def load_place(word: str) -> str:
    """Load a place for a scenario: ``Scenario(place=load_place('mine.yaml'))``.

    Args:
        word: a shipped name, a YAML file, or ``apt.dat:ICAO/RUNWAY`` (docs/world.md).

    Raises:
        UsageError: none of these, or an invalid file.
    """
    return typed_place(str(word)).text


@lru_cache(maxsize=8)
def _place_of_airport(path: str, icao: str, runway: str, zone: str) -> Place:
    # Imported here because it loads a library that is not needed for looking up places.
    from taxinet_ros.core.place.apt_dat import read_airport_place

    return find_place(read_airport_place(Path(path), icao, runway, zone).text)


def is_reference(text: str) -> bool:
    """Whether a text is a :attr:`.Place.reference`."""
    return text in SHIPPED_PLACES or _REFERENCE.fullmatch(text) is not None


def default_runway() -> Runway:
    """The runway of the paper, KMWH 04."""
    return find_place(DEFAULT_PLACE).runway
