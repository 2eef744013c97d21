"""Cameras that are not real but could be: mounted where a small high-wing aircraft allows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from taxinet_ros.core.rig.camera_model import CameraModel, make_camera
from taxinet_ros.errors import UsageError

_Range = tuple[float, float]


class _Mount(NamedTuple):
    """Where a camera can be: [m] from the reference point, and its pitch [deg]."""

    x_m: _Range
    aside_m: _Range
    z_m: _Range
    pitch_deg: _Range = (4.0, 13.0)


_MOUNTS = {
    'caravan': (
        _Mount((-0.3, 0.5), (1.6, 4.2), (0.35, 1.2)),  # below a wing, or on its strut
        _Mount((3.4, 4.4), (0.0, 0.15), (-0.85, -0.55)),  # below the nose
        _Mount((0.2, 1.2), (0.0, 0.4), (1.65, 1.9)),  # on the roof
        _Mount((-5.8, -5.0), (0.0, 0.0), (2.4, 3.1), (11.0, 18.0)),  # on the fin
    ),
    'c172p': (
        _Mount((-0.1, 0.5), (1.5, 3.6), (0.2, 0.72)),
        _Mount((1.2, 1.9), (0.0, 0.2), (-0.85, -0.65)),
        _Mount((0.2, 0.9), (0.0, 0.4), (1.0, 1.2)),
    ),
}
"""By aircraft; aside on either side."""
_SIZES = ((360, 200), (360, 240), (480, 270), (640, 360))
_NAME = Path('random camera')
_DISTORTED = 0.4
"""Share of the lenses that distort."""
_NOISY = 0.3
"""Share of the sensors with noise, which takes as long as the picture."""


def random_camera(rng: np.random.Generator, aircraft: str) -> CameraModel:
    """A camera on an aircraft, one of the shipped ones by its name.

    It looks ahead, within 8 degrees to the side, where the eye looks, too; what else its lens and
    sensor do is usual for small ones.
    """
    mounts = _MOUNTS[aircraft]
    mount = mounts[int(rng.choice(len(mounts), p=_shares(len(mounts))))]
    width, height = _SIZES[int(rng.integers(len(_SIZES)))]
    side = float(rng.choice((-1.0, 1.0)))
    values: dict[str, Any] = {
        'name': 'random_camera',
        'offset_m': [
            round(rng.uniform(*mount.x_m), 3), round(side * rng.uniform(*mount.aside_m), 3),
            round(rng.uniform(*mount.z_m), 3),
        ],
        'roll_deg': round(float(np.clip(rng.normal(0, 1.5), -4, 4)), 2),
        'pitch_deg': round(rng.uniform(*mount.pitch_deg), 2),
        'yaw_deg': round(rng.uniform(-8, 8), 2),
        'size_px': [width, height],
        'field_of_view_deg': round(rng.uniform(66, 100), 1),
        'centre_px': [
            round((width - 1) / 2 + rng.normal(0, 0.01 * width), 1),
            round(height * rng.uniform(0.28, 0.5), 1),
        ],
        'exposure_ev': round(rng.normal(0, 0.3), 2),
        'noise_codes': round(rng.uniform(1, 4), 1) if rng.uniform() < _NOISY else 0.0,
    }
    if rng.uniform() < _DISTORTED:
        bend = rng.uniform(-0.24, 0.02)
        values['distortion'] = [
            round(bend, 4), round(0.2 * bend * bend + rng.uniform(0, 0.02), 4),
            round(rng.normal(0, 3e-4), 5), round(rng.normal(0, 3e-4), 5), 0.0,
        ]
    try:
        return make_camera(values, _NAME)
    except UsageError:  # a lens that cannot be undone
        del values['distortion']
        return make_camera(values, _NAME)


def _shares(count: int) -> list[float]:
    """Below the wing is the most usual place."""
    return [0.5, *[0.5 / (count - 1)] * (count - 1)]
