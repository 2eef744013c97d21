"""Pictures of an aircraft from outside, and of a camera's view and where it looks."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from taxinet_ros.analysis.camera.sheets import DESCRIBED, contact_sheet, scene_picture
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import BY_HAND, CameraModel, make_camera
from taxinet_ros.core.rig.catalogue import CAMERAS
from taxinet_ros.core.scenario import Scenario

_SIZE_PX = (480, 300)
_ANGLE_DEG = 44.0
_SIDES = (
    ('from ahead, right', -28.0, 14.0), ('from the left', 90.0, 8.0),
    ('from behind, left', 152.0, 18.0), ('from above, behind', 180.0, 55.0),
)
"""Caption of each view, and azimuth (to the left) and elevation of its camera [deg]."""
_DISTANCE = 1.35
"""Distance of these cameras, relative to the aircraft's greatest extent."""
_HOUR_S = 15 * 3600.0
_WING, _CAMERA, _SEEN = '#7d848c', '#b03a2e', '#f2c14e'
_AHEAD_M = 14.0


def draw_aircraft(aircraft: AircraftModel, path: Path) -> None:
    """Draw an aircraft, with its shadow, from four sides into a PNG file."""
    points = np.concatenate([part.points for part in aircraft.outline])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    scene = Scenario(aircraft=aircraft.text, time_of_day_s=_HOUR_S, distance_m=700.0)
    state = Aircraft(scene).state
    distance_m = _DISTANCE * float(np.ptp(points, axis=0).max())
    tiles = [
        (Camera(scene, model=_outside(middle, distance_m, *angles)).render(state, 0), words)
        for words, *angles in _SIDES
    ]
    contact_sheet(tiles, 2, path, title=aircraft.title)


def _outside(
    middle: np.ndarray, distance_m: float, left_deg: float, up_deg: float
) -> CameraModel:
    """A camera outside an aircraft, looking at its centre."""
    left, up = math.radians(left_deg), math.radians(up_deg)
    away = np.array([math.cos(up) * math.cos(left), math.cos(up) * math.sin(left), math.sin(up)])
    values = {
        'name': 'outside', 'offset_m': (middle + distance_m * away).tolist(),
        'pitch_deg': up_deg, 'yaw_deg': (left_deg + 360.0) % 360.0 - 180.0,
        'size_px': list(_SIZE_PX), 'field_of_view_deg': _ANGLE_DEG,
    }
    return make_camera(values, Path('outside'))


def draw_camera(camera: CameraModel, aircraft: AircraftModel, path: Path) -> None:
    """Draw into a PNG file what a camera sees on an aircraft, and where it stands and looks."""
    scene = Scenario(camera=camera.text, aircraft=aircraft.text, time_of_day_s=_HOUR_S)
    frame = scene_picture(scene)
    figure = Figure(figsize=(11.0, 8.6), dpi=100, layout='constrained')
    view, beside = figure.subplots(2, 1, height_ratios=(1.5, 1.0))
    view.imshow(frame)
    view.set_title(f'{camera.title}, on {aircraft.title}')
    view.set(xlabel=f'{camera.width_px} px', ylabel=f'{camera.height_px} px', xticks=[], yticks=[])
    above, side = beside.inset_axes((0, 0, 0.47, 1)), beside.inset_axes((0.53, 0, 0.47, 1))
    beside.set_axis_off()
    _draw_plan(above, camera, aircraft, 1, 'from above')
    _draw_plan(side, camera, aircraft, 2, 'from the right')
    figure.savefig(path, format='png', metadata={'Software': None})


def _draw_plan(
    axes: Axes, camera: CameraModel, aircraft: AircraftModel, across: int, title: str
) -> None:
    """Draw the outline in the body frame, and the axis and edges of the view."""
    hulls = [
        cv2.convexHull(part.points[:, [0, across]].astype(np.float32))[:, 0]
        for part in aircraft.outline if part.seen
    ]
    axes.add_collection(PolyCollection(hulls, facecolor=_WING, edgecolor='none', alpha=0.6))
    eye = np.array(camera.offset_m)
    u, v = (camera.width_px - 1) / 2, (camera.height_px - 1) / 2
    first, last = (
        ((0.0, v), (2 * u, v)) if across == 1 else ((u, 0.0), (u, 2 * v))
    )
    pixels = np.array([first, last, camera.centre_px])
    x, y = camera.straight_rays(pixels[:, 0], pixels[:, 1])
    rays = np.stack([x, y, np.ones_like(x)], axis=1) @ camera.body_to_optical
    ends = eye + _AHEAD_M * rays
    wedge = np.array([eye, ends[0], ends[1]])[:, [0, across]]
    axes.fill(wedge[:, 0], wedge[:, 1], color=_SEEN, alpha=0.35, linewidth=0)
    axes.plot([eye[0], ends[2, 0]], [eye[across], ends[2, across]], color=_CAMERA, linewidth=1)
    axes.plot(*eye[[0, across]], 'o', color=_CAMERA, markersize=6)
    axes.set_aspect('equal')
    axes.set(title=title, xlabel='x forward [m]', xlim=(-8.5, _AHEAD_M))
    axes.set_ylabel('y left [m]' if across == 1 else 'z up [m]')
    axes.set_ylim((-8.5, 8.5) if across == 1 else (-3.0, 6.0))


def camera_text(camera: CameraModel) -> str:
    """What a camera is: a name and its value a line."""
    u, v = (camera.width_px - 1) / 2, (camera.height_px - 1) / 2
    x, _ = camera.straight_rays(np.array([-0.5, 2 * u + 0.5]), np.array([v, v]))
    _, y = camera.straight_rays(np.array([u, u]), np.array([-0.5, 2 * v + 0.5]))
    # The field of view along the middle row and the middle column.
    angles = tuple(math.degrees(math.atan(b) - math.atan(a)) for a, b in (x, y))
    return macro_text(
        DESCRIBED, 'camera', c=camera, deg=math.degrees, angles=angles, by_hand=BY_HAND,
        usual=CAMERAS.find(CAMERAS.default),
    )
