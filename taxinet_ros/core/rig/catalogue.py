"""Lookup of aircraft and cameras, see :mod:`taxinet_ros.core.documents`."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.core.documents import Catalogue
from taxinet_ros.core.rig.aircraft_model import AircraftModel, make_aircraft, read_aircraft
from taxinet_ros.core.rig.camera_model import CameraModel, make_camera, read_camera

_SHIPPED = Path(__file__).parent / 'shipped'

AIRCRAFT: Catalogue[AircraftModel] = Catalogue(
    'aircraft', shipped=('caravan', 'c172p'), read=read_aircraft, make=make_aircraft,
    folder=_SHIPPED / 'aircraft',
)
"""The paper's Caravan, a Cessna 172, and the user's."""
find_aircraft = AIRCRAFT.find
DEFAULT_AIRCRAFT = AIRCRAFT.default

CAMERAS: Catalogue[CameraModel] = Catalogue(
    'camera', shipped=('wing', 'strut', 'nose', 'tail'), read=read_camera, make=make_camera,
    folder=_SHIPPED / 'cameras',
)
"""The paper's wing camera, those on a strut, below the nose and on the fin, and the user's."""
find_camera = CAMERAS.find
DEFAULT_CAMERA = CAMERAS.default
WING = find_camera(DEFAULT_CAMERA)
"""The paper's camera, the default."""


def load_aircraft(word: str) -> str:
    """Load an aircraft for a scenario: ``Scenario(aircraft=load_aircraft('mine.yaml'))``.

    Args:
        word: a shipped name, or a YAML file (docs/world.md).

    Raises:
        UsageError: neither, or an invalid file.
    """
    return AIRCRAFT.typed(str(word)).text


def load_camera(word: str) -> str:
    """Load a camera for a scenario: ``Scenario(camera=load_camera('mine.yaml'))``.

    Args:
        word: a shipped name, or a YAML file (docs/world.md).

    Raises:
        UsageError: neither, or an invalid file.
    """
    return CAMERAS.typed(str(word)).text
