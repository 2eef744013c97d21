"""``taxinet aircraft``: measure and draw an aircraft, or list all."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from taxinet_ros.cli.options import PictureOption, refuse_given


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
    from taxinet_ros.analysis.camera.sheets import DESCRIBED
    from taxinet_ros.analysis.report.text import macro_text
    from taxinet_ros.cli.training.pictures import new_picture, write_picture
    from taxinet_ros.core.motion.aircraft import checked_aircraft, full_steering_rad
    from taxinet_ros.core.rig.catalogue import AIRCRAFT

    if name is None:
        refuse_given(context, ('out',), 'only with an AIRCRAFT')
        for shipped in map(AIRCRAFT.find, AIRCRAFT.shipped):
            print(f'{shipped.name:<9} model {shipped.model:<9} {shipped.title}')
        return
    given = AIRCRAFT.typed(name)
    found = checked_aircraft(given)
    path = new_picture(out, f'aircraft-{found.name}') if found.outline else None
    print(macro_text(
        DESCRIBED, 'aircraft', given=given, found=found, full_rad=full_steering_rad(found),
        deg=math.degrees,
    ))
    if path is None:
        print('outline     none: it casts no shadow, and no camera sees anything of it')
        return
    write_picture(path, lambda: draw_aircraft(found, path))
    print(f'picture: {path}')
