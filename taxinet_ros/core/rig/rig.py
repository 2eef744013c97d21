"""The rig of a run: which camera is where on which aircraft."""

from __future__ import annotations

from dataclasses import dataclass

from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import CameraModel


@dataclass(frozen=True, kw_only=True, slots=True)
class Rig:
    """A camera and the aircraft that carries it, which perceptions may be told of.

    It says nothing of a run's start or surroundings.

    Attributes:
        camera: lens, sensor and mounting, where its offsets have moved it.
        aircraft: the aircraft.
    """

    camera: CameraModel
    aircraft: AircraftModel
