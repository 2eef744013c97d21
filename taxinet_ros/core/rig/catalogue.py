"""Lookup of aircraft and cameras, see :mod:`taxinet_ros.core.documents`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from taxinet_ros.core.documents import Catalogue
from taxinet_ros.core.rig.aircraft_model import AircraftModel, make_aircraft, read_aircraft
from taxinet_ros.core.rig.camera_model import (
    MOST_OFFSET_DEG,
    MOST_OFFSET_M,
    OFFSETS,
    CameraModel,
    make_camera,
    moved_camera,
)
from taxinet_ros.files.plain_values import Section, read_yaml

_SHIPPED = Path(__file__).parent / 'shipped'

AIRCRAFT: Catalogue[AircraftModel] = Catalogue(
    'aircraft', shipped=('caravan', 'c172p'), read=read_aircraft, make=make_aircraft,
    folder=_SHIPPED / 'aircraft',
)
"""The paper's Caravan, a Cessna 172, and the user's."""
find_aircraft = AIRCRAFT.find
DEFAULT_AIRCRAFT = AIRCRAFT.default


def _read_camera(path: Path, shipped: bool) -> CameraModel:
    values = read_yaml(path, option='camera')
    return make_camera(values, path, shipped=True) if shipped else _given_camera(values, path)


def _given_camera(values: object, path: Path) -> CameraModel:
    """The camera of a file or of a scenario: a whole one, or another one moved."""
    if not (isinstance(values, Mapping) and 'base' in values):
        return make_camera(values, path)
    top = Section(path, values, ('base', *OFFSETS))
    offsets = (
        top.number(key, -most, most, 0.0)
        for key in OFFSETS for most in (MOST_OFFSET_M if key.endswith('_m') else MOST_OFFSET_DEG,)
    )
    base = values['base']
    if isinstance(base, Mapping):
        camera = make_camera(base, path)
    else:
        word = top.text('base', kind='the name or the YAML file of a camera')
        # Files are for files: a scenario from a bag has the whole base.
        beside = path.parent / word if path.suffix else None
        camera = CAMERAS.find(word) if beside is None or not beside.suffix else CAMERAS.typed(
            str(beside))
    if camera.base is not None:
        raise top.wrong('is moved itself; name the camera that it moves', 'base')
    return moved_camera(camera, tuple(offsets))


CAMERAS: Catalogue[CameraModel] = Catalogue(
    'camera', shipped=('wing', 'strut', 'nose', 'tail'), read=_read_camera, make=_given_camera,
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
