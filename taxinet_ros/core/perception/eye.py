"""The eye: a virtual camera through which a network sees the frames of every real one.

A network that learns from one camera learns its mounting and lens too. Through the eye it need not:
the frame is warped to what a level pinhole camera on the aircraft's axis would have seen, straight
to the network's grey picture. The mounting, the lens with its distortion, and the size of the frame
are geometry, not something to learn; as in openpilot's calibrated frame.

The ground is a plane, and the picture of a plane in one camera is a homography of that in another:
exact for what lies on the ground. What is above the horizon is taken as infinitely far, where the
homography is a rotation. Both are one formula: the eye's ray ``d`` falls by ``t`` per metre ahead
and meets the ground at ``d h / t``, ``h`` below the eye; from the real camera, displaced from the
eye by ``c``, that point is seen along ``d - c t / h``, and with ``t = 0`` along ``d``. The aircraft
is taken to stand as it does when it taxies straight ahead. What stands on the ground, and the
aircraft's own parts, appear where the ground behind them would.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.perception.network import FAR_ROWS, INPUT_SHAPE, UNSEEN
from taxinet_ros.core.rig.aircraft_model import AircraftModel, Attitude
from taxinet_ros.core.rig.camera_model import rotation
from taxinet_ros.core.rig.rig import Rig

_ACROSS, _DOWN = 4, 4
"""Samples of a pixel."""
_STEPS = 32
"""Steps of a sample's position in a pixel of the frame."""
_BEYOND = 2**24
"""Positions that are certainly outside a frame, in these steps."""
_DIGITS = 12
"""Rounding of the few numbers that come from sines: equal on every machine."""

Vectors = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class View:
    """A virtual camera: level, looking ahead, above the aircraft's reference point.

    Its rows have two heights, as those of :func:`.network.shrink`: fine ones from above the horizon
    down, and coarse ones near the aircraft, where a metre covers many.

    Attributes:
        height_m: above the ground [m].
        side: tangent of the angle from straight ahead to the left and to the right edge.
        above, far, near: tangents of the angles below the horizon at the upper edge, where the fine
            rows end, and at the lower edge.
    """

    height_m: float
    side: float
    above: float
    far: float
    near: float

    def rays(self) -> tuple[Vectors, Vectors]:
        """Slopes of the samples: to the right, (columns, 4), and down, (rows, 4)."""
        rows, columns = INPUT_SHAPE
        fine = np.linspace(self.above, self.far, FAR_ROWS * _DOWN + 1)
        coarse = np.linspace(self.far, self.near, (rows - FAR_ROWS) * _DOWN + 1)
        down = np.concatenate([(edges[:-1] + edges[1:]) / 2 for edges in (fine, coarse)])
        edges = np.linspace(-self.side, self.side, columns * _ACROSS + 1)
        right = (edges[:-1] + edges[1:]) / 2
        return right.reshape(columns, _ACROSS), down.reshape(rows, _DOWN)

    def pixel(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Column and row of a point on the ground [m], in front of the aircraft's axis."""
        rows, columns = INPUT_SHAPE
        right, down = -y_m / x_m, self.height_m / x_m
        if down <= self.far:
            row = FAR_ROWS * (down - self.above) / (self.far - self.above)
        else:
            row = FAR_ROWS + (rows - FAR_ROWS) * (down - self.far) / (self.near - self.far)
        return columns * (right + self.side) / (2 * self.side) - 0.5, row - 0.5


VIEWS = {'ahead': View(height_m=2.0, side=0.8, above=-0.01, far=0.12, near=0.45)}
"""Virtual cameras by the names that networks ask for.

``ahead`` sees what the wing camera, the one on the strut and the one below the nose all see: to
39 degrees on each side, and from the horizon, with three rows above it, to 4.4 m ahead of the
aircraft's reference point."""


class Eye:
    """Frames of one rig, seen through a virtual camera."""

    def __init__(self, view: View, rig: Rig) -> None:
        """Work out which pixels of a frame are seen where; some tens of milliseconds.

        Raises:
            UsageError: the attitude of the aircraft cannot be measured.
        """
        self._shape = rig.camera.shape
        self._warp = pixels.Warp(*self._shape[:2], _places(view, rig), UNSEEN)

    def see(self, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The eye's grey picture, (64, 192) uint8, of a frame (height, width, 3) uint8 RGB.

        Raises:
            ValueError: the frame is not of the rig's size.
        """
        if frame.shape != self._shape:
            raise ValueError(f'eye: the frame is {frame.shape}, of the rig it is {self._shape}')
        return self._warp.look(np.ascontiguousarray(frame))


@lru_cache(maxsize=16)
def find_eye(view: str, rig: Rig) -> Eye:
    """The eye of a name of :data:`VIEWS` for a rig; made once.

    Raises:
        UsageError: the attitude of the aircraft cannot be measured.
    """
    return Eye(VIEWS[view], rig)


def frame_places(
    view: View, rig: Rig, right: Vectors, down: Vectors
) -> tuple[Vectors, Vectors]:
    """Where in a rig's frame rays of a view are seen: columns and rows, NaN where they are not.

    Without products of matrices, whose last bit differs between processors.

    Args:
        view: the view.
        rig: the rig.
        right: slopes of the rays to the right, of any shape.
        down: slopes downwards, of the same shape.
    """
    camera, settled = rig.camera, _settled(rig.aircraft)
    body = rotation(settled.roll_rad, settled.pitch_rad, 0.0)
    place = np.array([0.0, 0.0, settled.z_m]) + body @ np.array(camera.offset_m)
    turn = np.round(camera.body_to_optical @ body.T, _DIGITS)
    x_m, y_m, up_m = np.round(place, _DIGITS)
    # The ray ahead, and by how much the place of the real camera shifts what is on the ground.
    fall = np.maximum(down, 0.0) / view.height_m
    ways = 1.0 - fall * x_m, -right - fall * y_m, -down + fall * (view.height_m - up_m)
    x, y, z = (row[0] * ways[0] + row[1] * ways[1] + row[2] * ways[2] for row in turn)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        u, v = camera.pixels_of_slopes(x / z, y / z)
    unseen = ~(z > 0)
    u[unseen] = v[unseen] = np.nan
    return u, v


def _settled(aircraft: AircraftModel) -> Attitude:
    settled = aircraft.settled
    if settled is None:
        # Imported here because it loads the flight-dynamics library.
        from taxinet_ros.core.motion.aircraft import measured_model

        settled = measured_model(aircraft).settled
    assert settled is not None
    return settled


def _places(view: View, rig: Rig) -> NDArray[np.int32]:
    """Positions of all samples in the frame, (64, 192, 16, 2), in its steps."""
    right, down = view.rays()
    whole = *INPUT_SHAPE, _DOWN, _ACROSS
    u, v = frame_places(
        view, rig, np.broadcast_to(right[None, :, None, :], whole).copy(),
        np.broadcast_to(down[:, None, :, None], whole).copy(),
    )
    places = np.rint(np.stack([u, v], axis=-1).reshape(*INPUT_SHAPE, -1, 2) * _STEPS)
    within = (np.abs(places) < _BEYOND).all(axis=-1, keepdims=True)  # not of what is NaN
    return np.where(within, places, -1.0).astype(np.int32)
