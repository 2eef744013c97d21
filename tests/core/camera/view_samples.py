"""Views of a camera, for what is looked up along its rays."""

from __future__ import annotations

import numpy as np

from taxinet_ros.core.camera.camera import intrinsics
from taxinet_ros.core.rig.camera_model import rotation


def rays_of(yaw_rad: float, pitch_rad: float, roll_rad: float = 0.0) -> np.ndarray:
    """Pixel to map of a camera that looks ahead (x forward, y left, z up), then is turned."""
    to_optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return rotation(roll_rad, pitch_rad, yaw_rad) @ to_optical @ np.linalg.inv(intrinsics())
