"""The scene as markers for 3-D viewers: ground, aircraft and others."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from itertools import pairwise

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from nav_msgs.msg import Odometry
from scipy.spatial import ConvexHull
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from taxinet_ros.core.place.markings import Polygon, markings
from taxinet_ros.core.place.place import AirportGround
from taxinet_ros.core.place.runway import Crossing, Runway
from taxinet_ros.core.place.track import Track, painted_line
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.motion import TrafficMotion
from taxinet_ros.core.traffic.shapes import UNSEEN, body, daylight_colour
from taxinet_ros.core.traffic.traffic import NOTHING_HELD, GroundObject, Holds, Traffic
from taxinet_ros.core.types import quaternion
from taxinet_ros.nodes.messages.convert import header, stamp_of

_ASPHALT, _CONCRETE = (0.30, 0.30, 0.32), (0.38, 0.38, 0.39)
_YELLOW = (0.95, 0.72, 0.10)
_PAINT, _AIRFRAME, _PATH = (0.95, 0.95, 0.90), (0.98, 0.95, 0.90), (0.95, 0.45, 0.10)
_THICKNESS_M = 0.02
_PAINT_LIFT_M = 0.03
_CROSSING_LENGTH_M = 600.0
_PATH_WIDTH_M = 0.3
Triangle = tuple[tuple[float, float, float], ...]


def ground_markers(scene: Scenario) -> MarkerArray:
    """What stays where it is, in ``map``: pavement, paint, and others that stand on the ground."""
    runway, track, airport = scene.runway, scene.line, scene.airport
    pavement = _marker('pavement', Marker.CUBE, _ASPHALT)
    pavement.pose.position = Point(x=runway.length_m / 2, z=-_THICKNESS_M / 2)
    pavement.scale = Vector3(x=runway.length_m, y=runway.width_m, z=_THICKNESS_M)
    crossings = [_crossing(*numbered) for numbered in enumerate(runway.crossings)]
    paint = _triangles('paint', _paint_triangles(runway), _PAINT)
    aside = [] if track.is_runway else _taxiway(track, runway)
    around = [] if airport is None else _airport(airport)
    others = [
        _other(scene.others, number, 0)
        for number, one in enumerate(scene.others.objects) if not one.path
    ]
    return MarkerArray(markers=[pavement, *crossings, paint, *aside, *around, *others])


def _taxiway(track: Track, runway: Runway) -> list[Marker]:
    strip = track.strip(track.half_width_m)
    # The outline goes out on the right and comes back on the left: each two points of it make a
    # triangle with the one across.
    ground = [
        ((*here, -_THICKNESS_M), (*ahead, -_THICKNESS_M), (*across, -_THICKNESS_M))
        for (here, ahead), across in zip(pairwise(strip), reversed(strip[:-1]), strict=True)
    ]
    return [
        _triangles('taxiway', ground, _CONCRETE),
        _lines('taxi_line', painted_line(track, runway), _YELLOW),
    ]


def _airport(airport: AirportGround) -> list[Marker]:
    """Outlines of pavements, which may be of any shape, and painted lines."""
    outlines = [
        (*polygon, polygon[0]) for area in airport.pavements
        for polygon in (area.outline, *area.holes)
    ]
    return [
        _lines('airport_pavements', outlines, _CONCRETE),
        _lines('airport_lines', [line.points for line in airport.lines], _YELLOW),
    ]


def _lines(
    namespace: str, lines: Iterable[Polygon], colour: tuple[float, float, float]
) -> Marker:
    marker = _marker(namespace, Marker.LINE_LIST, colour)
    marker.scale.x = _PATH_WIDTH_M
    marker.points = [
        Point(x=x, y=y, z=_PAINT_LIFT_M)
        for line in lines for ends in pairwise(line) for x, y in ends
    ]
    return marker


def _other(
    others: Traffic, number: int, stamp_ns: int, held: Holds | None = NOTHING_HELD
) -> Marker:
    """One of the others on the ground at a simulated time [ns]; none if nobody knows where."""
    one = others.objects[number]
    if held is None and one.reacts:
        return Marker(action=Marker.DELETE, ns='others', id=number)
    marker = _triangles('others', *_other_mesh(one))
    marker.id = number
    at = others.pose(number, stamp_ns, held or NOTHING_HELD)
    marker.pose.position = Point(x=at.x_m, y=at.y_m)
    marker.pose.orientation = _quaternion(*quaternion(0.0, 0.0, at.heading_rad))
    return marker


@lru_cache(maxsize=64)
def _other_mesh(one: GroundObject) -> tuple[list[Triangle], tuple[float, float, float]]:
    """Triangles of an object in its own frame, and its colour."""
    red, green, blue = (code / 255 for code in daylight_colour(one.colour))
    if not one.solid:
        half_x, half_y = one.size.length_m / 2, one.size.width_m / 2
        corners = [
            (x, y, _PAINT_LIFT_M) for x, y in
            ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y))
        ]
        return [tuple(corners[:3]), (corners[0], *corners[2:])], (red, green, blue)
    triangles: list[Triangle] = [
        (points[face[0]], points[first], points[second])
        for part in body(one.kind, one.size) if part.colour != UNSEEN
        for points in [[(x, y, z) for x, y, z in part.corners.tolist()]]
        for face in part.faces for first, second in pairwise(face[1:])
    ]
    return triangles, (red, green, blue)


def _crossing(number: int, crossing: Crossing) -> Marker:
    marker = _marker('crossing', Marker.CUBE, _CONCRETE)
    marker.id = number
    marker.pose.position = Point(x=crossing.x_m, z=-_THICKNESS_M)
    marker.pose.orientation = _quaternion(*quaternion(0.0, 0.0, crossing.yaw_rad))
    marker.scale = Vector3(x=_CROSSING_LENGTH_M, y=crossing.width_m, z=_THICKNESS_M)
    return marker


class MovingMarkers:
    """The aircraft with its path, and others on the ground that move, in the current run."""

    def __init__(self) -> None:
        """Start without a path, with the usual scene."""
        self._ground: tuple[str, str, str] | None = None
        self.change(Scenario())
        self._cleared = True
        self._path = _marker('path', Marker.LINE_STRIP, _PATH)
        self._path.scale.x = _PATH_WIDTH_M
        self._last_ns = -1

    def change(self, scene: Scenario) -> MarkerArray | None:
        """Draw the aircraft and the others of another scene from now on.

        Returns:
            Markers that replace those of the ground before; None if it is the same.
        """
        triangles = _aircraft_triangles(scene.aircraft_model)
        self._body = _triangles('aircraft', triangles, _AIRFRAME)
        self._others, self._motion = scene.others, TrafficMotion(scene.others, scene.period_ns)
        self._moving = [k for k, one in enumerate(scene.others.objects) if one.path]
        self._cleared = False
        before, self._ground = self._ground, (scene.place, scene.track, scene.traffic)
        if before == self._ground:
            return None
        markers = ground_markers(scene).markers
        return MarkerArray(markers=[Marker(action=Marker.DELETEALL), *markers])

    def markers(self, odometry: Odometry) -> MarkerArray:
        """Markers at an odometry message, in its frame; a jump back in time starts a new path."""
        stamp_ns = stamp_of(odometry.header.stamp)
        at = odometry.pose.pose
        if stamp_ns < self._last_ns:
            self._path.points = []
        self._last_ns = stamp_ns
        self._path.points.append(Point(x=at.position.x, y=at.position.y, z=_PAINT_LIFT_M * 2))
        self._body.pose = Pose(position=at.position, orientation=at.orientation)
        held = self._motion.step(stamp_ns, at.position.x, at.position.y)
        others = [_other(self._others, number, stamp_ns, held) for number in self._moving]
        for marker in (self._body, self._path, *others):
            marker.header = odometry.header
        # Those of a scene before would stay.
        before = [] if self._cleared else [Marker(action=Marker.DELETEALL)]
        self._cleared = True
        return MarkerArray(markers=[*before, self._body, self._path, *others])


def _marker(namespace: str, kind: int, colour: tuple[float, float, float]) -> Marker:
    red, green, blue = colour
    return Marker(
        header=header(0), ns=namespace, type=kind, action=Marker.ADD,
        color=ColorRGBA(r=red, g=green, b=blue, a=1.0),
    )


def _triangles(
    namespace: str, triangles: Iterable[Triangle], colour: tuple[float, float, float]
) -> Marker:
    marker = _marker(namespace, Marker.TRIANGLE_LIST, colour)
    marker.scale = Vector3(x=1.0, y=1.0, z=1.0)
    marker.points = [Point(x=x, y=y, z=z) for corners in triangles for x, y, z in corners]
    return marker


def _paint_triangles(runway: Runway) -> list[Triangle]:
    """Each marking as a triangle fan: they are (almost) convex."""
    return [
        tuple((x, y, _PAINT_LIFT_M) for x, y in (marking.polygon[0], left, right))
        for marking in markings(runway)
        for left, right in pairwise(marking.polygon[1:])
    ]


@lru_cache(maxsize=8)
def _aircraft_triangles(aircraft: AircraftModel) -> tuple[Triangle, ...]:
    """Convex hulls of the parts that also cast its shadow, relative to the reference point."""
    found = []
    for points in (part.points for part in aircraft.outline if part.shades):
        # A flat part has no hull; with QJ, qhull perturbs its corners slightly and finds one.
        faces = points[ConvexHull(points, qhull_options='QJ').simplices]
        found += [tuple(map(tuple, face)) for face in np.round(faces, 3).tolist()]
    return tuple(found)


def _quaternion(x: float, y: float, z: float, w: float) -> Quaternion:
    return Quaternion(x=x, y=y, z=z, w=w)
