"""``taxinet camera``: describe and draw a camera, or list all."""

from __future__ import annotations

from typing import Annotated

import typer

from taxinet_ros.cli.checked import tell_doubts
from taxinet_ros.cli.completion import complete_aircraft
from taxinet_ros.cli.options import PictureOption, YamlOption, refuse_given


def camera(
    context: typer.Context,
    name: Annotated[
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
    yaml: YamlOption = None,
) -> None:
    """Describe a camera, and with --out draw what it sees and where it looks, or list all."""
    from taxinet_ros.analysis.camera.rig_pictures import camera_text, draw_camera
    from taxinet_ros.cli.training.pictures import new_picture, write_document, write_picture
    from taxinet_ros.core.camera.airframe import covering_doubts
    from taxinet_ros.core.motion.aircraft import checked_aircraft
    from taxinet_ros.core.rig.catalogue import AIRCRAFT, CAMERAS

    if name is None:
        refuse_given(context, ('aircraft', 'out', 'yaml'), 'only with a CAMERA')
        for shipped in CAMERAS.shipped:
            found = CAMERAS.find(shipped)
            print(f'{shipped:<6} {found.width_px}x{found.height_px}  {found.title}')
        return
    found = CAMERAS.typed(name)
    on = checked_aircraft(AIRCRAFT.typed(aircraft or AIRCRAFT.default))
    path = None if out is None else new_picture(out, '')
    if yaml is not None:
        write_document(found, yaml)
    print(camera_text(found))
    if path is not None:
        write_picture(path, lambda: draw_camera(found, on, path))
    tell_doubts(covering_doubts(on, found))
