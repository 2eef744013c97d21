"""A place: a runway, and what else of its airport is known, as one frozen value with a digest."""

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
        holes: likewise, of what is not paved within.
    """

    surface: str
    outline: Polygon
    holes: tuple[Polygon, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PaintedLine:
    """A line on the ground, such as the centreline of a taxiway.

    Attributes:
        style: X-Plane's number of its look: 1 is a taxiway's solid yellow centreline.
        points: along it, (x, y) in ``map`` [m]; the first once more at the end of a closed one.
    """

    style: int
    points: Polygon


@dataclass(frozen=True, kw_only=True)
class TaxiRoute:
    """An edge of the network of ways that aircraft taxi on.

    Attributes:
        name: of the taxiway, or ''.
        one_way: whether it is only taxied from its first point to its last.
        on_runway: whether it runs along a runway.
        points: its ends, (x, y) in ``map`` [m].
    """

    name: str
    one_way: bool
    on_runway: bool
    points: Polygon


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where runs take place.

    Attributes:
        name: lower-case identifier, used on the command line and in tables.
        title: display name.
        icao: of the airport, or ''.
        runway: that is taxied along.
        pavements, lines, routes: what else is known of the airport's ground.
        document: all of this as canonical JSON, from which it can be made again.
        shipped: whether it came with the program, so that its name says it all.
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
        """What a scenario has of it, enough to find it anywhere: a shipped name, or everything."""
        return self.name if self.shipped else self.document

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the document."""
        return hashlib.sha256(self.document.encode()).hexdigest()

    @property
    def reference(self) -> str:
        """What tables have of it: a shipped name, or ``NAME@DIGEST`` with 12 digits of it."""
        return self.name if self.shipped else f'{self.name}@{self.digest[:_DIGEST_SIGNS]}'
