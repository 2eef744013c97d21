"""``taxinet aircraft``, and ``taxinet camera list`` and ``show``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

from taxinet_ros.analysis.camera.rig_pictures import draw_aircraft, draw_camera
from taxinet_ros.cli.checked import check_output, tell_doubts
from taxinet_ros.cli.training.camera import new_picture, write_picture
from taxinet_ros.core.camera.airframe import covering_doubts
from taxinet_ros.core.motion.aircraft import checked_aircraft, full_steering_rad
from taxinet_ros.core.rig.aircraft_model import AircraftModel
from taxinet_ros.core.rig.camera_model import BY_HAND, CameraModel
from taxinet_ros.core.rig.catalogue import AIRCRAFT, CAMERAS
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import dump_yaml
from taxinet_ros.trials.requirements import SUFFIXES


def print_aircraft() -> None:
    """Print a line for each shipped aircraft."""
    for name in AIRCRAFT.shipped:
        aircraft = AIRCRAFT.find(name)
        print(f'{name:<9} model {aircraft.model:<9} {aircraft.title}')


def show_aircraft(word: str, out: Path | None) -> None:
    """Load and measure an aircraft, print its parameters and draw it.

    Raises:
        UsageError: an invalid file, an aircraft that cannot taxi, or an unwritable picture.
    """
    given = AIRCRAFT.typed(word)
    aircraft = checked_aircraft(given)
    path = new_picture(out, f'aircraft-{aircraft.name}') if aircraft.outline else None
    for label, text in _aircraft_lines(given, aircraft):
        print(f'{label:<12}{text}')
    if path is None:
        print('outline     none: it casts no shadow, and no camera sees anything of it')
        return
    write_picture(path, lambda: draw_aircraft(aircraft, path))
    print(f'picture: {path}')


def _aircraft_lines(given: AircraftModel, found: AircraftModel) -> Iterator[tuple[str, str]]:
    yield 'aircraft', f'{found.reference}: {found.title}'
    files = f', {len(found.files)} files carried by scenarios' if found.files else ''
    yield 'model', f'{found.model} (JSBSim){files}'
    full_deg = math.degrees(full_steering_rad(found))
    limit_deg = math.degrees(found.max_steering_rad) if found.max_steering_rad else full_deg
    yield 'steering', f'{limit_deg:g} deg to each side, its wheel turns to {full_deg:g}'
    if math.isfinite(found.most_wind_mps):
        yield 'wind', f'wind_speed_mps + 3 gust_mps up to {found.most_wind_mps:g}'
    settled, gains = found.settled, found.speed_gains
    assert settled is not None
    assert gains is not None
    # In the syntax of the file, to be pasted there.
    yield 'settled', (
        f'{{height_m: {settled.z_m:.5f}, pitch_deg: {math.degrees(settled.pitch_rad):.4f}, '
        f'roll_deg: {math.degrees(settled.roll_rad):.4f}}}{_measured(given.settled)}'
    )
    yield 'speed_hold', (
        f'{{lever_per_mps: {gains.lever_per_mps:g}, lever_per_m: {gains.lever_per_m:g}, '
        f'brake_per_lever: {gains.brake_per_lever:g}, rolling_lever: {gains.rolling_lever:g}}}'
        f'{_measured(given.speed_gains)}'
    )
    if found.outline:
        shades, seen = (
            sum(getattr(part, name) for part in found.outline) for name in ('shades', 'seen')
        )
        yield 'outline', f'{shades} convex parts cast its shadow, {seen} are seen by cameras'


def _measured(given: object) -> str:
    return '  (measured)' if given is None else ''


def print_cameras() -> None:
    """Print a line for each shipped camera."""
    for name in CAMERAS.shipped:
        camera = CAMERAS.find(name)
        print(f'{name:<6} {camera.width_px}x{camera.height_px}  {camera.title}')


def show_camera(word: str, on: str | None, out: Path | None, yaml_out: Path | None) -> None:
    """Print the parameters of a camera, draw its view, and write its file if wanted.

    Raises:
        UsageError: unknown camera or aircraft, an invalid file, or an unwritable picture or file.
    """
    camera, aircraft = CAMERAS.typed(word), checked_aircraft(AIRCRAFT.typed(on or AIRCRAFT.default))
    path = new_picture(out, f'camera-{camera.name}')
    if yaml_out is not None:
        _write_camera(camera, yaml_out)
    for label, text in _camera_lines(camera):
        print(f'{label:<12}{text}')
    write_picture(path, lambda: draw_camera(camera, aircraft, path))
    print(f'picture: {path}' if yaml_out is None else f'picture: {path}, file: {yaml_out}')
    tell_doubts(covering_doubts(aircraft, camera))


def _write_camera(camera: CameraModel, path: Path) -> None:
    """Write the file of a camera, with which its pictures are the same."""
    if path.suffix not in SUFFIXES:
        raise UsageError(f'--yaml {path}: camera files end in .yaml; use {path.stem}.yaml')
    check_output(f'--yaml {path}', path)
    try:
        with path.open('x', encoding='utf-8') as file:
            file.write(dump_yaml(json.loads(camera.document)))
    except OSError as error:
        raise UsageError(f'--yaml {path}: cannot be written: {error.strerror}') from error


def _camera_lines(camera: CameraModel) -> Iterator[tuple[str, str]]:
    yield 'camera', f'{camera.reference}: {camera.title}'
    x, y, z = camera.offset_m
    ways = ((x, 'forward', 'back'), (y, 'left', 'right'), (z, 'up', 'down'))
    words = ', '.join(f'{abs(value):g} m {one if value >= 0 else other}'
                      for value, one, other in ways)
    yield 'mount', f'{words} from the centre of gravity'
    roll, pitch, yaw = map(math.degrees, (camera.roll_rad, camera.pitch_rad, camera.yaw_rad))
    yield 'attitude', f'roll {roll:g}, pitch {pitch:g} (nose down), yaw {yaw:g} (left) deg'
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    yield 'lens', f'focal {fx:.6g}, {fy:.6g} px, centre {cx:.6g}, {cy:.6g} px'
    yield 'picture', f'{camera.width_px} x {camera.height_px} px, {_angles(camera)}'
    if camera.distorts:
        yield 'distortion', 'k1 {:g}, k2 {:g}, p1 {:g}, p2 {:g}, k3 {:g}'.format(*camera.distortion)
    if camera.aircraft_parts == BY_HAND:
        yield 'aircraft', "aircraft_parts: by_hand, the Caravan's cowling and nose wheel only"
    yield 'sensor', f'exposure {camera.exposure_ev:+g} EV, noise {camera.noise_codes:g} codes'
    if camera.shape != CAMERAS.find(CAMERAS.default).shape:
        yield 'networks', 'take 360x200: they get the frame averaged to that, out of its aspect'


def _angles(camera: CameraModel) -> str:
    """Field of view along the middle row and the middle column."""
    import numpy as np

    u, v = (camera.width_px - 1) / 2, (camera.height_px - 1) / 2
    x, _ = camera.straight_rays(np.array([-0.5, 2 * u + 0.5]), np.array([v, v]))
    _, y = camera.straight_rays(np.array([u, u]), np.array([-0.5, 2 * v + 0.5]))
    across, down = (math.degrees(math.atan(b) - math.atan(a)) for a, b in (x, y))
    return f'field of view {across:.1f} x {down:.1f} deg'
