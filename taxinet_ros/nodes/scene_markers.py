"""Executable ``scene_markers``: publish runway, aircraft and path as markers for 3-D viewers.

It works with any graph or ``bag_player`` without taking part. The Foxglove server publishes the
same markers.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from nav_msgs.msg import Odometry
from scipy.spatial import ConvexHull
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.core.place.markings import markings
from taxinet_ros.core.place.runway import Crossing, Runway
from taxinet_ros.core.place.track import Track, painted_line
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.catalogue import DEFAULT_AIRCRAFT, find_aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import quaternion
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import Topic
from taxinet_ros.nodes.lockstep.observer import Observer
from taxinet_ros.nodes.messages.convert import header, stamp_of
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Usage, published_topics, refuse_unknown

_ASPHALT, _CONCRETE = (0.30, 0.30, 0.32), (0.38, 0.38, 0.39)
_YELLOW = (0.95, 0.72, 0.10)
_PAINT, _AIRFRAME, _PATH = (0.95, 0.95, 0.90), (0.98, 0.95, 0.90), (0.95, 0.45, 0.10)
_THICKNESS_M = 0.02
_PAINT_LIFT_M = 0.03
_CROSSING_LENGTH_M = 600.0
_PATH_WIDTH_M = 0.3
Triangle = tuple[tuple[float, float, float], ...]


def runway_markers(runway: Runway, track: Track | None = None) -> MarkerArray:
    """Pavement, crossings, all paint, and a track that leaves the runway, in ``map``."""
    pavement = _marker('pavement', Marker.CUBE, _ASPHALT)
    pavement.pose.position = Point(x=runway.length_m / 2, z=-_THICKNESS_M / 2)
    pavement.scale = Vector3(x=runway.length_m, y=runway.width_m, z=_THICKNESS_M)
    crossings = [_crossing(*numbered) for numbered in enumerate(runway.crossings)]
    paint = _triangles('paint', _paint_triangles(runway), _PAINT)
    aside = [] if track is None or track.is_runway else _taxiway(track, runway)
    return MarkerArray(markers=[pavement, *crossings, paint, *aside])


def other_runway_markers(runway: Runway, track: Track) -> MarkerArray:
    """The same markers, replacing those of another runway or track."""
    markers = runway_markers(runway, track).markers
    return MarkerArray(markers=[Marker(action=Marker.DELETEALL), *markers])


def _taxiway(track: Track, runway: Runway) -> list[Marker]:
    strip = track.strip(track.half_width_m)
    # The outline goes out on the right and comes back on the left: each two points of it make a
    # triangle with the one across.
    ground = [
        ((*here, -_THICKNESS_M), (*ahead, -_THICKNESS_M), (*across, -_THICKNESS_M))
        for (here, ahead), across in zip(pairwise(strip), reversed(strip[:-1]), strict=True)
    ]
    lines = [
        ((*start, _PAINT_LIFT_M), (*end, _PAINT_LIFT_M))
        for line in painted_line(track, runway) for start, end in pairwise(line)
    ]
    paint = _marker('taxi_line', Marker.LINE_LIST, _YELLOW)
    paint.scale.x = _PATH_WIDTH_M
    paint.points = [Point(x=x, y=y, z=z) for ends in lines for x, y, z in ends]
    return [_triangles('taxiway', ground, _CONCRETE), paint]


def _crossing(number: int, crossing: Crossing) -> Marker:
    marker = _marker('crossing', Marker.CUBE, _CONCRETE)
    marker.id = number
    marker.pose.position = Point(x=crossing.x_m, z=-_THICKNESS_M)
    marker.pose.orientation = _quaternion(*quaternion(0.0, 0.0, crossing.yaw_rad))
    marker.scale = Vector3(x=_CROSSING_LENGTH_M, y=crossing.width_m, z=_THICKNESS_M)
    return marker


class AircraftMarkers:
    """The aircraft and its path in the current run."""

    def __init__(self) -> None:
        """Start without a path, with the usual aircraft."""
        self.change(find_aircraft(DEFAULT_AIRCRAFT))
        self._path = _marker('path', Marker.LINE_STRIP, _PATH)
        self._path.scale.x = _PATH_WIDTH_M
        self._last_ns = -1

    def change(self, aircraft: AircraftModel) -> None:
        """Draw another aircraft from now on."""
        self._body = _triangles('aircraft', _aircraft_triangles(aircraft), _AIRFRAME)

    def markers(self, odometry: Odometry) -> MarkerArray:
        """Markers at an odometry message, in its frame; a jump back in time starts a new path."""
        stamp_ns = stamp_of(odometry.header.stamp)
        at = odometry.pose.pose
        if stamp_ns < self._last_ns:
            self._path.points = []
        self._last_ns = stamp_ns
        self._path.points.append(Point(x=at.position.x, y=at.position.y, z=_PAINT_LIFT_M * 2))
        self._body.pose = Pose(position=at.position, orientation=at.orientation)
        self._body.header = self._path.header = odometry.header
        return MarkerArray(markers=[self._body, self._path])


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


USAGE = Usage(
    executable=interface.SCENE_MARKERS,
    does='Draws runway, aircraft and path as markers for RViz and other viewers, beside any graph '
    'or bag_player.',
    publishes=published_topics(interface.SCENE_MARKERS),
    subscribes=(interface.RUN_STATUS.name, interface.ODOMETRY.name, interface.SCENARIO.name),
)


class SceneMarkers(Observer):
    """Publishes markers from odometry."""

    def __init__(self, **node: Any) -> None:
        """Publish the static markers; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(interface.SCENE_MARKERS, **node)
        refuse_unknown(self)
        self._speakers = {
            topic.name: self.create_publisher(topic.type, topic.name, topic.qos)
            for topic in interface.SCENE
        }
        self._aircraft = AircraftMarkers()
        self._ground = Scenario().runway, Scenario().line
        self._say(interface.SCENE_RUNWAY, runway_markers(*self._ground))
        self.watch(interface.ODOMETRY, self._draw)
        self.watch(interface.SCENARIO, self._change_scene)

    def _change_scene(self, message: Any) -> None:
        scene = scenario_of(message)
        self._aircraft.change(scene.aircraft_model)
        ground = scene.runway, scene.line
        if ground != self._ground:
            self._ground = ground
            self._say(interface.SCENE_RUNWAY, other_runway_markers(*ground))

    def _draw(self, odometry: Odometry) -> None:
        self._say(interface.SCENE_AIRCRAFT, self._aircraft.markers(odometry))

    def _say(self, topic: Topic, message: Any) -> None:
        self._speakers[topic.name].publish(message)


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros scene_markers``."""
    run_node(SceneMarkers, usage=USAGE)

if __name__ == '__main__':
    main()
