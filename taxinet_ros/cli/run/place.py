"""``taxinet place``: draw a place from above, or list all."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import PictureOption, YamlOption, refuse_given

if TYPE_CHECKING:
    from taxinet_ros.core.place.place import Place


def place(
    context: typer.Context,
    name: Annotated[
        str | None,
        typer.Argument(
            metavar='[PLACE]', help='shipped name, YAML file, ICAO/RUNWAY of an installed apt.dat, '
            'or FILE.dat:ICAO/RUNWAY (default: list those that are shipped)'
        ),
    ] = None,
    out: PictureOption = None,
    yaml: YamlOption = None,
) -> None:
    """Describe a place, and draw it from above, or list all.

    The picture shows runway, markings, pavements and taxi routes.
    """
    from taxinet_ros.analysis.camera.place_map import plot_place
    from taxinet_ros.analysis.camera.sheets import DESCRIBED
    from taxinet_ros.analysis.report.text import macro_text
    from taxinet_ros.cli.training.pictures import new_picture, write_document, write_picture
    from taxinet_ros.core.place.catalogue import SHIPPED_PLACES, find_place, typed_place

    if name is None:
        refuse_given(context, ('out', 'yaml'), 'only with a PLACE')
        for shipped in SHIPPED_PLACES:
            _print_line(find_place(shipped))
        return
    found = typed_place(name)
    path = new_picture(out, f'place-{found.name}')
    if yaml is not None:
        write_document(found, yaml)
    print(macro_text(DESCRIBED, 'place', p=found, deg=math.degrees, unseen=_unseen(found)))
    write_picture(path, lambda: plot_place(found, path))
    print(f'picture: {path}')


def _print_line(place: Place) -> None:
    runway = place.runway
    tracks = f'; tracks {", ".join(place.track_names)}' if place.tracks else ''
    print(
        f'{place.name}  {runway.length_m:5.0f} m x {runway.width_m:5.2f} m  '
        f'{math.degrees(runway.bearing_rad):5.1f} deg  {runway.category:<12} '
        f'{place.title}{tracks}'
    )


def _unseen(place: Place) -> str:
    from taxinet_ros.core.camera.ground.taxiway import LINES
    from taxinet_ros.core.place.runway import SURFACES

    words = [
        f'{number} lines of type {style}'
        for style, number in sorted(Counter(line.style for line in place.lines).items())
        if style not in LINES
    ]
    if others := sum(area.surface not in SURFACES for area in place.pavements):
        words.append(f'{others} paved areas that are neither asphalt nor concrete')
    return ', '.join(words)
