"""A place: a runway and optional airport ground data, as one frozen value with a digest."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

from taxinet_ros.core.place.markings import Polygon
from taxinet_ros.core.place.runway import Runway

_DIGEST_SIGNS = 12


@dataclass(frozen=True, kw_only=True)
class Pavement:
    """A paved area beside the runway: taxiway or apron.

    Attributes:
        surface: one of :data:`~taxinet_ros.core.place.runway.SURFACES`, or ``other``.
        outline: corners (x, y) in ``map`` [m].
        holes: outlines of unpaved areas inside.
    """

    surface: str
    outline: Polygon
    holes: tuple[Polygon, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PaintedLine:
    """A painted line on the ground, such as a taxiway centreline.

    Attributes:
        style: X-Plane line type; 1 is a taxiway's solid yellow centreline.
        points: points (x, y) in ``map`` [m]; a closed line repeats the first at the end.
    """

    style: int
    points: Polygon


@dataclass(frozen=True, kw_only=True)
class TaxiRoute:
    """An edge of the taxi route network.

    Attributes:
        name: name of the taxiway, or ''.
        one_way: whether it is used only from its first point to its last.
        on_runway: whether it is on a runway.
        points: end points (x, y) in ``map`` [m].
    """

    name: str
    one_way: bool
    on_runway: bool
    points: Polygon


@dataclass(frozen=True, kw_only=True)
class Place:
    """Location of runs.

    Attributes:
        name: lower-case identifier, used on the command line and in tables.
        title: display name.
        icao: ICAO code of the airport, or ''.
        runway: runway for taxiing.
        pavements, lines, routes: optional ground data of the airport.
        document: the whole place as canonical JSON, from which it can be recreated.
        shipped: whether it is shipped with the package and identified by its name.
    """

    name: str
    title: str
    icao: str
    runway: Runway
    pavements: tuple[Pavement, ...] = ()
    lines: tuple[PaintedLine, ...] = ()
    routes: tuple[TaxiRoute, ...] = ()
    document: str
    shipped: bool = False

    @property
    def text(self) -> str:
        """Self-contained text for scenarios: a shipped name, or the document."""
        return self.name if self.shipped else self.document

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the document."""
        return hashlib.sha256(self.document.encode()).hexdigest()

    @property
    def reference(self) -> str:
        """Short text for tables: a shipped name, or ``NAME@DIGEST`` with 12 hex digits."""
        return self.name if self.shipped else f'{self.name}@{self.digest[:_DIGEST_SIGNS]}'
