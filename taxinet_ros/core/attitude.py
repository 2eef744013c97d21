"""Attitude as a unit quaternion, which is how messages carry it."""

from __future__ import annotations

import math


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Attitude as x, y, z, w from angles about x, y, z [rad], applied in the order z, y, x."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
