"""Cameras as data: mounting, lens and sensor, from YAML files and from the JSON in scenarios.

The pinhole model is that of ROS: pixel centres are integers, the optical axis meets the image at
(cx, cy). Distortion is Brown and Conrady's model with the five coefficients of ``plumb_bob``
(k1, k2, p1, p2, k3), as in sensor_msgs/CameraInfo and OpenCV.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.documents import NamedDocument, canonical, document_name
from taxinet_ros.core.types import quaternion, quaternion_product
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section

LEAST_SIDE_PX, MOST_SIDE_PX = 8, 2048
"""Limits of the image size."""
LEAST_HEIGHT_M = 0.1
"""Above the ground, where the aircraft stands on its wheels."""
_MOST_ASIDE = math.tan(math.radians(75.0))
"""Largest angle from the optical axis, as a tangent."""
_MOST_INNER_PX = 6144
_KEYS = (
    'name', 'title', 'offset_m', 'roll_deg', 'pitch_deg', 'yaw_deg', 'size_px',
    'field_of_view_deg', 'focal_px', 'centre_px', 'distortion', 'exposure_ev', 'noise_codes',
    'aircraft_parts',
)
OFFSETS = ('dx_m', 'dy_m', 'dz_m', 'droll_deg', 'dpitch_deg', 'dyaw_deg')
"""Keys of a moved camera, beside its ``base``."""
MOST_OFFSET_M, MOST_OFFSET_DEG = 1.0, 20.0
_ANGLES_DEG = {'roll': (-20.0, 20.0), 'pitch': (-30.0, 60.0), 'yaw': (-180.0, 180.0)}
PARTS = (OUTLINE, BY_HAND) = ('outline', 'by_hand')
"""How the own aircraft is drawn in its pictures: from its outline; or the Caravan as in the
paper's pictures, by hand (:mod:`taxinet_ros.core.camera.airframe`)."""
_OPTICAL_TO_LINK = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_NEWTON_STEPS = 30
_BESIDE = 1.05
"""Range of validity of a lens model, relative to the tangent of the farthest pixel."""
_ROUND_TRIP_PX = 0.02
"""Largest error of undistorting any pixel."""

Vectors = NDArray[np.float64]


def rotation(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Vectors:
    """Rotation matrix (3, 3) of REP-103 fixed-axis angles, from the rotated to the base frame."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class CameraModel(NamedDocument):
    """Mounting, lens and sensor of a camera.

    Attributes:
        offset_m: camera in the body frame (x forward, y left, z up) from the reference point [m].
        roll_rad, pitch_rad, yaw_rad: attitude (REP-103: pitch positive nose down, yaw positive
            left) [rad].
        width_px, height_px: image size.
        focal_px: focal lengths along a row and along a column.
        centre_px: principal point.
        distortion: k1, k2, p1, p2, k3.
        exposure_ev: exposure compensation in stops; +1 doubles the light.
        noise_codes: standard deviation of the sensor's noise, in display codes 0..255.
        aircraft_parts: one of :data:`PARTS`.
        base, offsets: of a moved camera what was moved, and by how much: :data:`OFFSETS`.
    """

    offset_m: tuple[float, float, float]
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    width_px: int
    height_px: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    exposure_ev: float = 0.0
    noise_codes: float = 0.0
    aircraft_parts: str = OUTLINE
    base: CameraModel | None = None
    offsets: tuple[float, ...] = (0.0,) * len(OFFSETS)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of its images: height, width, 3 (RGB)."""
        return self.height_px, self.width_px, 3

    @property
    def distorts(self) -> bool:
        """Whether the lens is not a pinhole."""
        return any(self.distortion)

    @property
    def view(self) -> tuple[object, ...]:
        """All parameters of the projection, for comparing cameras."""
        return (
            self.offset_m, self.roll_rad, self.pitch_rad, self.yaw_rad, self.shape, self.focal_px,
            self.centre_px, self.distortion,
        )

    @property
    def look(self) -> tuple[object, ...]:
        """All parameters of the pictures, likewise."""
        return self.view, self.exposure_ev, self.noise_codes, self.aircraft_parts

    @cached_property
    def intrinsics(self) -> Vectors:
        """Camera matrix K (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def attitude(self) -> tuple[float, float, float, float]:
        """Quaternion (x, y, z, w) of ``camera_optical`` (z forward, x right) in ``base_link``."""
        turned = quaternion(self.roll_rad, self.pitch_rad, self.yaw_rad)
        return quaternion_product(turned, (-0.5, 0.5, -0.5, 0.5))

    @cached_property
    def body_to_optical(self) -> Vectors:
        """Rotation matrix (3, 3) from the body frame to the optical one."""
        to_body = rotation(self.roll_rad, self.pitch_rad, self.yaw_rad) @ _OPTICAL_TO_LINK
        return np.asarray(to_body.T)

    def pixels(self, points: Vectors) -> Vectors:
        """Project points (N, 3) in the optical frame [m] to pixels (N, 2).

        Valid only for positive depth. NaN where a distorting lens model is not valid, that is far
        outside the image.
        """
        with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
            if self.distorts:
                x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
                beyond = ~(np.hypot(x, y) <= self._reach)
                x, y = self._distorted(x, y)
                x[beyond] = y[beyond] = np.nan
                points = np.stack([x, y, np.ones_like(x)], axis=1)
            found: Vectors = (points @ self.intrinsics.T)[:, :2] / points[:, 2:]
        return found

    def pixels_of_slopes(self, x: Vectors, y: Vectors) -> tuple[Vectors, Vectors]:
        """Pixels of undistorted directions x/z and y/z; the inverse of :meth:`straight_rays`.

        Valid only for positive depth. NaN far outside the image, as in :meth:`pixels`. Elementwise:
        the same on every processor.
        """
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        if self.distorts:
            beyond = ~(np.sqrt(x * x + y * y) <= self._reach)
            x, y = self._distorted(x, y)
            x[beyond] = y[beyond] = np.nan
        return fx * x + cx, fy * y + cy

    def straight_rays(self, u: Vectors, v: Vectors) -> tuple[Vectors, Vectors]:
        """Undistorted directions x/z and y/z of pixels (Newton's method)."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        aimed_x, aimed_y = (u - cx) / fx, (v - cy) / fy
        if not self.distorts:
            return aimed_x, aimed_y
        x, y = aimed_x, aimed_y
        with np.errstate(all='ignore'):
            for _ in range(_NEWTON_STEPS):
                off_x, off_y = self._distorted(x, y)
                off_x, off_y = off_x - aimed_x, off_y - aimed_y
                dxx, dxy, dyy = self._slopes(x, y)
                area = dxx * dyy - dxy * dxy
                back_x, back_y = dyy * off_x - dxy * off_y, dxx * off_y - dxy * off_x
                x, y = x - back_x / area, y - back_y / area
        return x, y

    @cached_property
    def _reach(self) -> float:
        """Range of validity of the lens model, as a tangent; the farthest pixel is at the edge."""
        rows, columns = np.mgrid[0:self.height_px, 0:self.width_px].astype(np.float64)
        edge = np.ones(self.shape[:2], bool)
        edge[1:-1, 1:-1] = False
        return _BESIDE * float(np.hypot(*self.straight_rays(columns[edge], rows[edge])).max())

    def _distorted(self, x: Vectors, y: Vectors) -> tuple[Vectors, Vectors]:
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        )

    def _slopes(self, x: Vectors, y: Vectors) -> tuple[Vectors, Vectors, Vectors]:
        """Derivatives of the distorted x by x, of x by y (and y by x), and of y by y."""
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        bend = k1 + square * (2 * k2 + square * 3 * k3)
        return (
            radial + 2 * x * x * bend + 2 * p1 * y + 6 * p2 * x,
            2 * x * y * bend + 2 * p1 * x + 2 * p2 * y,
            radial + 2 * y * y * bend + 6 * p1 * y + 2 * p2 * x,
        )

    @cached_property
    def inner_view(self) -> tuple[Vectors, tuple[int, int], Vectors, Vectors]:
        """Pinhole image that contains the whole distorted one.

        Returns:
            Its camera matrix (3, 3), its height and width [px], and its coordinates along rows and
            along columns for each pixel of the distorted image, (height, width) each.
        """
        rows, columns = np.mgrid[0:self.height_px, 0:self.width_px].astype(np.float64)
        if not self.distorts:
            return self.intrinsics, self.shape[:2], columns, rows
        x, y = self.straight_rays(columns, rows)
        fx, fy = self.focal_px
        u, v = fx * x, fy * y
        left, top = math.floor(u.min()) - 1, math.floor(v.min()) - 1
        size = math.ceil(v.max()) - top + 2, math.ceil(u.max()) - left + 2
        matrix = np.array([[fx, 0.0, -left], [0.0, fy, -top], [0.0, 0.0, 1.0]])
        return matrix, size, u - left, v - top

    @property
    def inner_intrinsics(self) -> Vectors:
        """Camera matrix (3, 3) of :attr:`inner_view`."""
        return self.inner_view[0]


def make_camera(values: object, path: Path, *, shipped: bool = False) -> CameraModel:
    """Build a camera from plain values.

    Args:
        values: content of a camera file.
        path: path of the file, for error messages.
        shipped: whether it is shipped with the package.

    Raises:
        UsageError: an invalid value.
    """
    top = Section(path, values, _KEYS)
    name = document_name(top, 'wing')
    width, height = _size(top)
    x, y, z = top.numbers('offset_m', 3, -50.0, 50.0)
    most = width + height
    centre = top.numbers('centre_px', 2, -most, most, ((width - 1) / 2, (height - 1) / 2))
    k1, k2, p1, p2, k3 = top.numbers('distortion', 5, -10.0, 10.0, (0.0,) * 5)
    assert isinstance(values, Mapping)
    camera = CameraModel(
        name=name,
        title=top.text('title', name, kind='a title'),
        offset_m=(x, y, z),
        roll_rad=_angle_rad(top, 'roll'),
        pitch_rad=_angle_rad(top, 'pitch'),
        yaw_rad=_angle_rad(top, 'yaw'),
        width_px=width,
        height_px=height,
        focal_px=_focal(top, width),
        centre_px=(centre[0], centre[1]),
        distortion=(k1, k2, p1, p2, k3),
        exposure_ev=top.number('exposure_ev', -6.0, 6.0, 0.0),
        noise_codes=top.number('noise_codes', 0.0, 64.0, 0.0),
        aircraft_parts=top.word('aircraft_parts', PARTS, OUTLINE),
        document=canonical(values),
        shipped=shipped,
    )
    _check_view(top, camera)
    return camera


@lru_cache(maxsize=256)
def moved_camera(base: CameraModel, offsets: tuple[float, ...]) -> CameraModel:
    """A camera moved and turned from its place; the same one if nothing is.

    Args:
        base: the camera.
        offsets: by :data:`OFFSETS`; the angles are added to its own.

    Raises:
        UsageError: it would be turned beyond what a camera may be.
    """
    if not any(offsets):
        return base
    told = {key: value for key, value in zip(OFFSETS, offsets, strict=True) if value}
    turned = {}
    for name, added in zip(_ANGLES_DEG, offsets[3:], strict=True):
        low, high = _ANGLES_DEG[name]
        angle_deg = round(math.degrees(getattr(base, f'{name}_rad')) + added, 9)
        if name != 'yaw' and not low <= angle_deg <= high:
            raise UsageError(
                f'camera {base.name}: with its offset {name}_deg is {angle_deg:g}, outside '
                f'{low:g}..{high:g}'
            )
        turned[f'{name}_rad'] = getattr(base, f'{name}_rad') + math.radians(added)
    x, y, z = (place + added for place, added in zip(base.offset_m, offsets[:3], strict=True))
    of = base.name if base.shipped else json.loads(base.document)
    return replace(
        base, title=f'{base.title}; ' + ', '.join(f'{key} {told[key]:g}' for key in told),
        document=canonical({'base': of, **told}), shipped=False, base=base, offsets=offsets,
        offset_m=(x, y, z), **turned,
    )


def _angle_rad(top: Section, name: str) -> float:
    low, high = _ANGLES_DEG[name]
    return math.radians(top.number(f'{name}_deg', low, high, 0.0))


def _size(top: Section) -> tuple[int, int]:
    width, height = top.numbers('size_px', 2, LEAST_SIDE_PX, MOST_SIDE_PX)
    if width % 1 or height % 1:
        raise top.wrong(f'expected whole numbers, got {width:g} x {height:g}', 'size_px')
    return int(width), int(height)


def _focal(top: Section, width: int) -> tuple[float, float]:
    if ('focal_px' in top) == ('field_of_view_deg' in top):
        raise top.wrong('expected either field_of_view_deg, along a row, or focal_px')
    if 'focal_px' in top:
        along, across = top.numbers('focal_px', 2, 1.0, 20000.0)
        return along, across
    angle_deg = top.number('field_of_view_deg', 1.0, 150.0)
    focal = width / 2 / math.tan(math.radians(angle_deg) / 2)
    return focal, focal


def _check_view(top: Section, camera: CameraModel) -> None:
    """Refuse a lens that cannot be undistorted, or with too large an angle of view."""
    u = np.linspace(0.0, camera.width_px - 1.0, 33)
    v = np.linspace(0.0, camera.height_px - 1.0, 33)
    columns, rows = (grid.ravel() for grid in np.meshgrid(u, v))
    x, y = camera.straight_rays(columns, rows)
    key = 'distortion' if camera.distorts else ''
    if camera.distorts:
        fx, fy = camera.focal_px
        cx, cy = camera.centre_px
        again_x, again_y = camera._distorted(x, y)
        off = np.hypot(fx * again_x + cx - columns, fy * again_y + cy - rows).max()
        # Beyond the turning point of the polynomial, pixels would repeat directions.
        shares = np.linspace(0.0, 1.0, 17)[:, None]
        dxx, dxy, dyy = camera._slopes(shares * x, shares * y)
        if not (off < _ROUND_TRIP_PX and (dxx * dyy - dxy * dxy > 0).all() and (dxx > 0).all()):
            raise top.wrong('it cannot be undone everywhere in the picture', key)
    farthest = float(np.hypot(x, y).max())
    if not farthest < _MOST_ASIDE:
        raise top.wrong(
            f'the picture looks {math.degrees(math.atan(farthest)):.0f} deg aside of its axis, '
            f'expected less than {math.degrees(math.atan(_MOST_ASIDE)):.0f}', key,
        )
    if camera.distorts and max(camera.inner_view[1]) > _MOST_INNER_PX:
        raise top.wrong('the picture without it would be too large to be made', key)
