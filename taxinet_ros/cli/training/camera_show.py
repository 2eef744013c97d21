"""``taxinet camera show``: describe a camera and draw what it sees, or list all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.checked import tell_doubts
from taxinet_ros.cli.completion import complete_aircraft
from taxinet_ros.cli.options import PictureOption, refuse_given
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.core.rig.camera_model import CameraModel


def show_camera(
    context: typer.Context,
    camera: Annotated[
        str | None,
        typer.Argument(metavar='[CAMERA]', help='shipped name, or YAML file of one (default: list '
                       'those that are shipped)'),
    ] = None,
    aircraft: Annotated[
        str | None,
        typer.Option(
            metavar='NAME|FILE', help='aircraft: caravan, c172p, or a YAML file of one',
            autocompletion=complete_aircraft,
        ),
    ] = None,
    out: PictureOption = None,
    yaml: Annotated[
        Path | None,
        typer.Option(
            '--yaml', metavar='FILE.yaml', writable=True, dir_okay=False,
            help='also write it as a YAML file, to be changed; must be new',
        ),
    ] = None,
) -> None:
    """Describe a camera, and with --out draw what it sees and where it looks, or list all."""
    from taxinet_ros.analysis.camera.rig_pictures import camera_text, draw_camera
    from taxinet_ros.cli.training.pictures import new_picture, write_picture
    from taxinet_ros.core.camera.airframe import covering_doubts
    from taxinet_ros.core.motion.aircraft import checked_aircraft
    from taxinet_ros.core.rig.catalogue import AIRCRAFT, CAMERAS

    if camera is None:
        refuse_given(context, ('aircraft', 'out', 'yaml'), 'only with a CAMERA')
        for name in CAMERAS.shipped:
            found = CAMERAS.find(name)
            print(f'{name:<6} {found.width_px}x{found.height_px}  {found.title}')
        return
    found = CAMERAS.typed(camera)
    on = checked_aircraft(AIRCRAFT.typed(aircraft or AIRCRAFT.default))
    path = None if out is None else new_picture(out, '')
    if yaml is not None:
        _write_camera(found, yaml)
    print(camera_text(found))
    if path is not None:
        write_picture(path, lambda: draw_camera(found, on, path))
    tell_doubts(covering_doubts(on, found))


def _write_camera(camera: CameraModel, path: Path) -> None:
    """Write the file of a camera, with which its pictures are the same."""
    from taxinet_ros.files.plain_values import dump_yaml
    from taxinet_ros.trials.requirements import SUFFIXES

    if path.suffix not in SUFFIXES:
        raise UsageError(f'--yaml {path}: camera files end in .yaml; use {path.stem}.yaml')
    try:
        with path.open('x', encoding='utf-8') as file:
            file.write(dump_yaml(json.loads(camera.document)))
    except OSError as error:
        raise UsageError(f'--yaml {path}: cannot be written: {error.strerror}') from error
