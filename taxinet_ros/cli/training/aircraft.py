"""``taxinet aircraft``: measure and draw an aircraft, or list all."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import PictureOption, refuse_given

if TYPE_CHECKING:
    from taxinet_ros.core.rig.aircraft_model import AircraftModel


def aircraft(
    context: typer.Context,
    name: Annotated[
        str | None,
        typer.Argument(metavar='[AIRCRAFT]', help='shipped name, or YAML file of one (default: '
                       'list those that are shipped)'),
    ] = None,
    out: PictureOption = None,
) -> None:
    """Load an aircraft, measure it, say what is wrong, and draw it, or list all.

    Measures what its file leaves out.
    """
    from taxinet_ros.analysis.camera.rig_pictures import draw_aircraft
    from taxinet_ros.cli.training.pictures import new_picture, write_picture
    from taxinet_ros.core.motion.aircraft import checked_aircraft
    from taxinet_ros.core.rig.catalogue import AIRCRAFT

    if name is None:
        refuse_given(context, ('out',), 'only with an AIRCRAFT')
        for shipped in map(AIRCRAFT.find, AIRCRAFT.shipped):
            print(f'{shipped.name:<9} model {shipped.model:<9} {shipped.title}')
        return
    given = AIRCRAFT.typed(name)
    found = checked_aircraft(given)
    path = new_picture(out, f'aircraft-{found.name}') if found.outline else None
    for label, text in _lines(given, found):
        print(f'{label:<12}{text}')
    if path is None:
        print('outline     none: it casts no shadow, and no camera sees anything of it')
        return
    write_picture(path, lambda: draw_aircraft(found, path))
    print(f'picture: {path}')


def _lines(given: AircraftModel, found: AircraftModel) -> Iterator[tuple[str, str]]:
    from taxinet_ros.core.motion.aircraft import full_steering_rad

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
