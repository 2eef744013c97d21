"""``taxinet place``: draw a place from above, or list all."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import PictureOption, refuse_given

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
) -> None:
    """Describe a place, and draw it from above, or list all.

    The picture shows runway, markings, pavements and taxi routes.
    """
    from taxinet_ros.analysis.camera.place_map import plot_place
    from taxinet_ros.cli.training.pictures import new_picture, write_picture
    from taxinet_ros.core.place.catalogue import SHIPPED_PLACES, find_place, typed_place

    if name is None:
        refuse_given(context, ('out',), 'only with a PLACE')
        for shipped in SHIPPED_PLACES:
            _print_line(find_place(shipped))
        return
    found = typed_place(name)
    path = new_picture(out, f'place-{found.name}')
    for label, text in _lines(found):
        print(f'{label:<12}{text}')
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


def _lines(place: Place) -> Iterator[tuple[str, str]]:
    runway = place.runway
    yield 'place', f'{place.reference}: {place.title}'
    for number, (latitude, longitude) in enumerate((runway.threshold_deg, runway.end_deg)):
        displaced = runway.displaced_m[number]
        more = f', threshold displaced by {displaced:g} m' if displaced else ''
        end = runway.designations[number]
        yield f'end {end}', f'{latitude:.6f} {longitude:.6f}{more}'
    yield 'runway', (
        f'{runway.length_m:.1f} m x {runway.width_m:g} m, '
        f'{math.degrees(runway.bearing_rad):.2f} deg true, {runway.elevation_m:g} m high'
    )
    edges = 'edge stripes' if runway.edge_stripes else 'no edge stripes'
    yield 'paint', f'{runway.category}, {edges}'
    paved = f', paved shoulders of {runway.shoulder_m:g} m' if runway.shoulder_m else ''
    yield 'ground', f'{runway.surface}{paved}, {runway.surroundings} beside it'
    yield 'clocks', runway.time_zone
    yield 'starts', (
        f'distance_m 0..{runway.last_start_m:g}, '
        f'cross_track_m -{runway.farthest_start_m:g}..{runway.farthest_start_m:g}'
    )
    for crossing in runway.crossings:
        yield 'crossing', f'at {crossing.x_m:g} m, {crossing.width_m:g} m wide'
    for track in place.tracks:
        turns = ', '.join(
            f'{abs(math.degrees(leg.curvature * leg.length_m)):.0f} deg to the '
            f'{"left" if leg.curvature > 0 else "right"} with {1 / abs(leg.curvature):g} m'
            for leg in track.legs if leg.curvature
        )
        yield 'track', f'{track.name}: {track.title}'
        yield '', f'{track.length_m:.0f} m x {track.width_m:g} m; {turns or "straight"}'
        yield '', (
            f'starts: distance_m 0..{track.last_start_m:g}, '
            f'cross_track_m -{track.farthest_start_m:g}..{track.farthest_start_m:g}'
        )
    if routes := place.track_names[1 + len(place.tracks):]:
        yield 'taxi routes', f'{", ".join(routes)}; as a track: one of them, or several as A+B'
    if place.pavements or place.lines or place.routes:
        yield 'around it', (
            f'{len(place.pavements)} pavements, {len(place.lines)} painted lines, '
            f'{len(place.routes)} taxi routes'
        )
    if unseen := _unseen(place):
        yield 'not seen', f'{unseen}: the camera does not show them'


def _unseen(place: Place) -> str:
    from taxinet_ros.core.camera.ground.taxiway import LINES
    from taxinet_ros.core.place.runway import SURFACES

    words = [
        f'{number} lines of type {style}'
        for style, number in sorted(Counter(line.style for line in place.lines).items())
        if style not in LINES
    ]
    if others := sum(area.surface not in SURFACES for area in place.pavements):
        words.append(f'{others} pavements of other surfaces')
    return ', '.join(words)
