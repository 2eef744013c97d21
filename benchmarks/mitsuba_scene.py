"""A scenario's scene in Mitsuba 3, built from documents: place, aircraft, camera, date and hour.

A second opinion on our camera: projection, shadows, the sun's position and the light of sun and sky
(Hosek and Wilkie 2012 and 2013) are Mitsuba's own. Taken from us are the documents, the reflectance
of the ground's materials, and the pose. Paint, pavement and the aircraft are meshes; the ground is
flat and its surfaces are uniform, without wear, rubber, joints or haze.

The scene's origin is below the aircraft, as Mitsuba's numbers are of single precision. Layers of
the ground lie 0.1 mm below each other, paint at the height of the ground. Equal scenes give equal
pictures with any number of threads: samples depend on pixel and block, and a box filter keeps the
blocks apart. The variant is ``scalar_rgb``, which needs no LLVM on the machine.
"""

from __future__ import annotations

import datetime
import importlib.util
import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.ground.pavement import GroundStyle, standard_style
from taxinet_ros.core.camera.ground.taxiway import LINE_WIDTH_M, LINES, Stripe
from taxinet_ros.core.camera.light import GAMMA
from taxinet_ros.core.place.markings import Polygon, markings
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import painted_line
from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS
from taxinet_ros.core.types import AircraftState
from taxinet_ros.errors import UsageError

SHOWS = frozenset({
    'cross_track_m', 'distance_m', 'heading_rad', 'time_of_day_s', 'date', 'shadows', 'crossing',
    'aircraft', 'camera', 'place', 'track',
})
"""Attributes of a scenario that the scene shows; the others have to have their defaults."""

NOT_INSTALLED = "mitsuba is not installed; pip install mitsuba 'shapely>=2.1'"

_VARIANT = 'scalar_rgb'
_REACH_M = 20_000.0
_NEAR_GROUND_M = 75.0
"""Distance from the centreline to which the ground has its near tint [m]."""
_CROSSING_REACH_M = 3_000.0
_LAYER_M = 1e-4
_FINENESS = 2
"""Film pixels along a pixel's longer side."""
_BLOCK_PX = 32
"""Side of what one thread renders at a time; else it would depend on the number of threads."""
_AWAY_M = 2_000.0
_KINDS = ('paint', 'pavement', 'ground')
_TURBIDITY = 3.0
_WORN = 0.24
"""Mean share of the paint that is worn off, where ours is at wear 1."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Coverage:
    """Shares of each pixel, 0..1, (height, width) each: paint, other pavement, and open ground."""

    paint: Floats
    pavement: Floats
    ground: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class _Layer:
    """Polygons of one material; ``kind`` is a field of :class:`Coverage`."""

    kind: str
    code: Floats
    shapes: tuple[Any, ...]


def check_installed() -> None:
    """Check that Mitsuba can be imported.

    Raises:
        UsageError: it is not installed, or does not work here.
    """
    _mitsuba()


def _mitsuba() -> Any:
    if importlib.util.find_spec('mitsuba') is None:
        raise UsageError(NOT_INSTALLED)
    try:
        import mitsuba

        mitsuba.set_variant(_VARIANT)
        # Warnings of the sky's model about a sun below the horizon, or near it.
        mitsuba.set_log_level(mitsuba.LogLevel.Error)
    except ImportError as error:
        raise UsageError(f'mitsuba is installed but cannot be imported: {error}') from error
    return mitsuba


def check_values(who: str, shows: Collection[str], scenario: Scenario) -> None:
    """Check that a scenario has only what another renderer's scene shows.

    Args:
        who: name of the renderer.
        shows: attributes that may differ from their defaults.
        scenario: the scene.

    Raises:
        UsageError: another one does.
    """
    told, usual = scenario.to_human(), Scenario().to_human()
    for field in SCENARIO_FIELDS:
        value = told[field.key]
        if (field.carrier or field.attribute) not in shows and value != usual[field.key]:
            raise UsageError(
                f'{who}: {field.key} is {value!s:.60}, which its scene does not show; leave it out'
            )


def check_shown(scenario: Scenario) -> None:
    """Check that a scenario has only what the scene shows.

    Raises:
        UsageError: a key with another effect on the picture, or a lens that is not a pinhole.
    """
    check_values('mitsuba', SHOWS, scenario)
    camera = scenario.camera_model
    if camera.distorts:
        raise UsageError(
            f'mitsuba: camera {camera.name}: its lens distorts, only pinholes can be compared'
        )


class MitsubaScene:
    """A scenario's scene from one state of the aircraft."""

    def __init__(self, scenario: Scenario, state: AircraftState) -> None:
        """Build the meshes.

        Args:
            scenario: place, aircraft, camera, date and hour.
            state: pose of the aircraft in ``map``.

        Raises:
            UsageError: Mitsuba is not installed, or the scenario has what it does not show.
        """
        check_shown(scenario)
        self._mi = _mitsuba()
        self._scenario, self._state = scenario, state
        self._layers = _layers(scenario, scenario.runway)
        # Only to the sampling of the lens, not to the scene.
        self._lens = _Lens(scenario.camera_model)

    def coverage(self) -> Coverage:
        """What is seen in each pixel, without the aircraft."""
        glow = dict(zip(_KINDS, np.eye(3), strict=True))
        picture = self._render(self._meshes(glow, glows=True), {'type': 'path', 'max_depth': 1})
        return Coverage(**dict(zip(_KINDS, np.moveaxis(picture, 2, 0), strict=True)))

    def sunlit(self) -> Floats:
        """Share of each pixel's ground that is out of the aircraft's shadow, (height, width).

        For a sun of no width. The aircraft is not in the picture: it is moved towards the sun,
        which leaves its shadow where it is.
        """
        white = self._meshes(dict.fromkeys(_KINDS, np.ones(3)))
        sun = {'type': 'directional', 'direction': (-self.sun).tolist(), 'irradiance': {
            'type': 'rgb', 'value': math.pi / max(float(self.sun[2]), 1e-3),
        }}
        casting = [part for part in self._scenario.aircraft_model.outline if part.shades]
        if casting:
            triangles = np.concatenate([_hull(part.points) for part in casting])
            body = np.array(self._body().matrix, np.float64)
            triangles = triangles @ body[:3, :3].T + body[:3, 3] + _AWAY_M * self.sun
            white['aircraft'] = self._mesh(triangles, np.zeros(3))
        return self._render({**white, 'sun': sun}, {'type': 'direct'})[:, :, 0]

    def radiance(self, samples: int = 4) -> tuple[Floats, Floats]:
        """Light from each pixel under sun and sky, and under the sky alone.

        Linear RGB, (height, width, 3) each, without the aircraft and its shadow.
        """
        albedo = {layer.kind: (layer.code / 255) ** GAMMA for layer in self._layers}
        meshes, found = self._meshes(albedo), []
        for sun_scale in (1.0, 0.0):
            sky = {
                'type': 'sunsky', 'sun_direction': self.sun.tolist(), 'turbidity': _TURBIDITY,
                'sun_scale': sun_scale,
            }
            found.append(self._render({**meshes, 'sky': sky}, {'type': 'direct'}, samples))
        return found[0], found[1]

    @cached_property
    def sun(self) -> Floats:
        """Unit vector towards the sun in ``map``, (3,), from place, date and hour by Mitsuba."""
        runway = self._scenario.runway
        latitude, longitude = runway.threshold_deg
        moment = datetime.datetime.fromisoformat(self._scenario.date).replace(tzinfo=runway.zone)
        moment += datetime.timedelta(seconds=self._scenario.time_of_day_s)
        offset = moment.utcoffset()
        assert offset is not None
        sky = self._mi.load_dict({
            'type': 'sunsky', 'latitude': latitude, 'longitude': longitude,
            'timezone': offset.total_seconds() / 3600, 'year': moment.year, 'month': moment.month,
            'day': moment.day,
            'hour': moment.hour + moment.minute / 60 + moment.second / 3600,
        })
        # Its axes are south, west and up.
        south, west, up = np.array(self._mi.traverse(sky)['sun_direction'], np.float64)
        sin, cos = math.sin(runway.bearing_rad), math.cos(runway.bearing_rad)
        return np.array([-south * cos - west * sin, -south * sin + west * cos, up])

    def _render(
        self, meshes: dict[str, Any], integrator: dict[str, Any], samples: int = 4
    ) -> Floats:
        mi = self._mi
        sensor = mi.load_dict({
            'type': 'perspective', 'to_world': self._camera(), 'near_clip': 0.05,
            'far_clip': 2 * _REACH_M, **self._lens.view,
            'film': {
                'type': 'hdrfilm', 'width': self._lens.size[1], 'height': self._lens.size[0],
                'rfilter': {'type': 'box'}, 'pixel_format': 'rgb', 'component_format': 'float32',
            },
            'sampler': {'type': 'stratified', 'sample_count': samples},
        })
        integrator = {**integrator, 'block_size': _BLOCK_PX}
        scene = mi.load_dict({'type': 'scene', 'integrator': integrator, **meshes})
        picture = np.array(mi.render(scene, sensor=sensor, spp=samples, seed=0), np.float64)
        return self._lens.pixels(picture[:, :, -3:])

    def _body(self) -> Any:
        """Body frame to the scene's frame."""
        turn, state = self._mi.ScalarTransform4f, self._state
        return (
            turn().translate([0, 0, state.z_m]) @ turn().rotate([0, 0, 1], _deg(state.yaw_rad))
            @ turn().rotate([0, 1, 0], _deg(state.pitch_rad))
            @ turn().rotate([1, 0, 0], _deg(state.roll_rad))
        )

    def _camera(self) -> Any:
        """Mitsuba's camera frame (x left, y up, z ahead) to the scene's."""
        turn, camera = self._mi.ScalarTransform4f, self._scenario.camera_model
        ahead = turn([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
        return (
            self._body() @ turn().translate(list(camera.offset_m))
            @ turn().rotate([0, 0, 1], _deg(camera.yaw_rad))
            @ turn().rotate([0, 1, 0], _deg(camera.pitch_rad))
            @ turn().rotate([1, 0, 0], _deg(camera.roll_rad)) @ ahead
        )

    def _meshes(self, colours: dict[str, Floats], *, glows: bool = False) -> dict[str, Any]:
        """The ground, each material in a colour that it reflects, or glows in."""
        return {
            f'ground_{number}': self._mesh(triangles, colours[layer.kind], glows=glows)
            for number, (layer, triangles) in enumerate(self._ground) if len(triangles)
        }

    @cached_property
    def _ground(self) -> list[tuple[_Layer, Floats]]:
        """Triangles of each layer, from the paint down, (n, 3, 3) each."""
        found = []
        for depth, layer in enumerate(reversed(self._layers)):
            flat = _triangles(layer.shapes) - (self._state.x_m, self._state.y_m)
            heights = np.full((*flat.shape[:2], 1), -depth * _LAYER_M)
            found.append((layer, np.concatenate([flat, heights], axis=2)))
        return found

    def _mesh(self, triangles: Floats, colour: Floats, *, glows: bool = False) -> Any:
        """Mesh of triangles (n, 3, 3)."""
        mi, count = self._mi, len(triangles)
        rgb = {'type': 'rgb', 'value': colour.tolist()}
        properties = mi.Properties()
        properties['bsdf'] = mi.load_dict({
            'type': 'twosided', 'bsdf': {'type': 'diffuse', 'reflectance': rgb},
        })
        if glows:
            properties['emitter'] = mi.load_dict({'type': 'area', 'radiance': rgb})
        mesh = mi.Mesh('mesh', 3 * count, count, props=properties)
        values = mi.traverse(mesh)
        values['vertex_positions'] = triangles.astype(np.float32).ravel()
        values['faces'] = np.arange(3 * count, dtype=np.uint32)
        values.update()
        return mesh


class _Lens:
    """A pinhole camera with square pixels that are finer than the picture's, and their mean."""

    def __init__(self, camera: CameraModel) -> None:
        (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
        step = 1 / (_FINENESS * max(fx, fy))
        # Film pixels along a side of a picture's.
        across, down = 1 / (fx * step), 1 / (fy * step)
        self.size = math.ceil(camera.height_px * down), math.ceil(camera.width_px * across)
        self.view = {
            'fov_axis': 'x', 'fov': _deg(2 * math.atan(self.size[1] * step / 2)),
            'principal_point_offset_x': 0.5 - (cx + 0.5) * across / self.size[1],
            'principal_point_offset_y': 0.5 - (cy + 0.5) * down / self.size[0],
        }
        self._rows = _shares(camera.height_px, down, self.size[0])
        self._columns = _shares(camera.width_px, across, self.size[1])

    def pixels(self, film: Floats) -> Floats:
        """Mean of the film over each pixel of the picture."""
        def along(shares: Any, planes: Floats) -> Floats:
            found: Floats = shares @ planes.reshape(len(planes), -1)
            return found.reshape(-1, *planes.shape[1:])

        wide = along(self._rows, film)
        return along(self._columns, wide.swapaxes(0, 1)).swapaxes(0, 1)


def _shares(count: int, wide: float, film: int) -> Any:
    """Share of each film pixel in the mean of each of ``count`` pixels, (count, film).

    Sparse, as products of dense matrices depend on the number of threads.
    """
    from scipy.sparse import csr_array

    left, at = wide * np.arange(count)[:, None], np.arange(film)[None]
    overlap = np.minimum(left + wide, at + 1) - np.maximum(left, at)
    return csr_array(np.maximum(overlap, 0) / wide)


def _deg(angle_rad: float) -> float:
    return math.degrees(angle_rad)


def _layers(scenario: Scenario, runway: Runway) -> tuple[_Layer, ...]:
    """The ground's layers from the lowest to the paint."""
    from shapely import MultiPoint, Polygon, box

    style = standard_style(runway, crossing=scenario.crossing)
    asphalt = style.asphalt * np.array(style.asphalt_tint)
    airport, line = scenario.airport, scenario.line
    paved = [MultiPoint(one.strip(_CROSSING_REACH_M)).convex_hull for one in runway.crossings] \
        if scenario.crossing else []
    if airport is not None:
        paved += [
            Polygon(area.outline, area.holes).buffer(0) for area in airport.pavements
            if area.surface in ('asphalt', 'concrete')
        ]
    if not line.is_runway:
        paved.append(Polygon(line.strip(line.half_width_m)).buffer(0))
    half = runway.half_width_m
    paved.append(box(0, -half, runway.length_m, half))
    painted = [
        Polygon(one.polygon) for one in markings(runway, crossing=scenario.crossing)
    ]
    if airport is not None:
        painted += [
            shape for one in airport.lines for stripe in LINES.get(one.style, ())
            for shape in _painted(one.points, stripe)
        ]
    if not line.is_runway:
        painted += [
            shape for points in painted_line(line, runway)
            for shape in _painted(points, Stripe(0.0, LINE_WIDTH_M))
        ]
    reach = _REACH_M
    return (
        _Layer(kind='ground', code=np.array(style.far_tint),
               shapes=(box(-reach, -reach, reach, reach),)),
        _Layer(kind='ground', code=np.array(style.near_tint),
               shapes=(box(-reach, -_NEAR_GROUND_M, reach, _NEAR_GROUND_M),)),
        _Layer(kind='pavement', code=asphalt, shapes=tuple(paved)),
        _Layer(kind='paint', code=_paint_code(style), shapes=tuple(painted)),
    )


def _paint_code(style: GroundStyle) -> Floats:
    paint = style.paint - _WORN * (style.paint - style.asphalt)
    return np.full(3, paint)


def _painted(points: Polygon, stripe: Stripe) -> Iterator[Any]:
    """Areas of one stripe along a line."""
    from shapely import LineString
    from shapely.ops import substring

    whole = LineString(points)
    if stripe.left_m:
        whole = whole.offset_curve(stripe.left_m)
    step = stripe.dash_m + stripe.gap_m
    starts: Iterable[float] = np.arange(stripe.start_m, whole.length, step) if step else (0.0,)
    for start in starts:
        piece = substring(whole, start, start + stripe.dash_m) if step else whole
        if piece.length:
            yield piece.buffer(stripe.width_m / 2, cap_style='flat', join_style='mitre')


def _triangles(shapes: Sequence[Any]) -> Floats:
    """Corners of the triangles of areas, (n, 3, 2)."""
    import shapely

    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(list(shapes)))
    corners: Floats = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    (ax, ay), (bx, by) = (corners[:, k].T - corners[:, 0].T for k in (1, 2))
    turned = ax * by < ay * bx
    # Counter-clockwise, so that they face up.
    corners[turned] = corners[turned][:, ::-1]
    return corners


def _hull(points: Floats) -> Floats:
    """Triangles of a convex hull, (n, 3, 3); joggled, as parts may be flat."""
    from scipy.spatial import ConvexHull

    found: Floats = points[ConvexHull(points, qhull_options='QJ').simplices]
    return found
