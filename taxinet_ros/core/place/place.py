"""A place: a runway, and what else of its airport is known, as one frozen value with a digest."""

from __future__ import annotations

from dataclasses import dataclass

from taxinet_ros.core.documents import NamedDocument
from taxinet_ros.core.place.markings import Polygon
from taxinet_ros.core.place.runway import Runway


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
class Place(NamedDocument):
    """Where runs take place.

    Attributes:
        icao: of the airport, or ''.
        runway: that is taxied along.
        pavements, lines, routes: what else is known of the airport's ground.
    """

    icao: str
    runway: Runway
    pavements: tuple[Pavement, ...] = ()
    lines: tuple[PaintedLine, ...] = ()
    routes: tuple[TaxiRoute, ...] = ()
