"""Map of a place: the airport's ground from above, and both runway ends enlarged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from taxinet_ros.core.place.markings import Polygon, markings
from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.track import painted_line

Points = NDArray[np.float64]

_GROUND, _PAVEMENT, _PAINT = '#b9b58f', '#6f7072', '#f4f2ea'
_APRON, _CROSSING, _LINE, _ROUTE = '#8f9093', '#7b7c7f', '#e0b400', '#1f6fb4'
_END_M, _BESIDE_M = 620.0, 30.0
_REACH_M = 900.0
"""Half length [m] at which a crossing runway is drawn if its ends are not known."""
_MARGIN_M = 150.0
_WIDTH_IN = 11.0


def plot_place(place: Place, path: Path) -> None:
    """Draw a place into a PNG file; the same place gives the same bytes."""
    figure = Figure(dpi=100, layout='constrained')
    runway = place.runway
    outlines = [_outline(runway), *(area.outline for area in place.pavements)]
    outlines += [track.strip(track.half_width_m) for track in place.tracks]
    corners = np.concatenate([_north_up(np.array(one), runway.bearing_rad) for one in outlines])
    width, height = np.ptp(corners, axis=0) + 2 * _MARGIN_M
    map_in = float(np.clip(_WIDTH_IN * height / width, 1.5, 9.0))
    figure.set_size_inches(_WIDTH_IN, map_in + 4.0)
    above, near, far = figure.subplots(3, 1, height_ratios=(map_in, 1.5, 1.5))
    _draw_ground(above, place, lambda points: _north_up(points, runway.bearing_rad))
    for track in place.tracks:
        at = _north_up(np.array([track.pose(track.length_m)[:2]]), runway.bearing_rad)[0]
        above.annotate(track.name, at, (6, 6), textcoords='offset points', fontsize=9)
    _add_compass(above)
    above.set_title(f'{place.title}: {runway.length_m:.0f} m × {runway.width_m:g} m, '
                    f'{math.degrees(runway.bearing_rad) % 360:.1f}° true, {runway.category}')
    for axes, end in ((near, 0), (far, 1)):
        _draw_end(axes, place, end)
    figure.savefig(path, format='png', metadata={'Software': None})


def _north_up(points: Points, bearing_rad: float) -> Points:
    """Convert points (N, 2) of ``map`` to metres east and north of the threshold."""
    sin, cos = math.sin(bearing_rad), math.cos(bearing_rad)
    x, y = points.T
    return np.stack([x * sin - y * cos, x * cos + y * sin], axis=1)


def _draw_ground(axes: Axes, place: Place, turn: Callable[[Points], Points]) -> None:
    runway = place.runway

    def turned(polygons: Iterable[Polygon]) -> list[Points]:
        return [turn(np.asarray(polygon, np.float64)) for polygon in polygons]

    axes.set_facecolor(_GROUND)
    areas = turned(area.outline for area in place.pavements)
    axes.add_collection(PolyCollection(areas, facecolors=_APRON, linewidths=0))
    holes = turned(hole for area in place.pavements for hole in area.holes)
    axes.add_collection(PolyCollection(holes, facecolors=_GROUND, linewidths=0))
    taxiways = turned(track.strip(track.half_width_m) for track in place.tracks)
    axes.add_collection(PolyCollection(taxiways, facecolors=_APRON, linewidths=0))
    crossings = turned(one.strip(_REACH_M) for one in runway.crossings)
    axes.add_collection(PolyCollection(crossings, facecolors=_CROSSING, linewidths=0))
    pavement = turned([_outline(runway)])
    axes.add_collection(PolyCollection(pavement, facecolors=_PAVEMENT, linewidths=0))
    paint = turned(marking.polygon for marking in markings(runway))
    # With snapping to pixels, stripes thinner than a pixel would vanish.
    axes.add_collection(PolyCollection(paint, facecolors=_PAINT, linewidths=0, snap=False))
    lines = turned([
        *(line.points for line in place.lines),
        *(line for track in place.tracks for line in painted_line(track, runway)),
    ])
    axes.add_collection(LineCollection(lines, colors=_LINE, linewidths=0.5))
    routes = turned(route.points for route in place.routes if not route.on_runway)
    axes.add_collection(LineCollection(routes, colors=_ROUTE, linewidths=0.8, linestyles=':'))
    seen = np.concatenate([*pavement, *areas, *taxiways])
    low, high = seen.min(axis=0) - _MARGIN_M, seen.max(axis=0) + _MARGIN_M
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect('equal')
    axes.set_xlabel('east of the threshold [m]')
    axes.set_ylabel('north [m]')


def _draw_end(axes: Axes, place: Place, end: int) -> None:
    """Draw one end in the runway's own frame, with its markings."""
    runway = place.runway
    _draw_ground(axes, place, lambda points: points)
    start = 0.0 if end == 0 else runway.length_m - _END_M
    axes.set_xlim(start - 20, start + _END_M + 20)
    half = runway.half_width_m + _BESIDE_M
    axes.set_ylim(-half, half)
    axes.set_title(f'end {runway.designations[end]}', fontsize=10)
    axes.set_xlabel('past the threshold [m]' if end == 1 else '')
    axes.set_ylabel('left [m]')


def _outline(runway: Runway) -> Polygon:
    length, half = runway.length_m, runway.half_width_m
    return (0.0, -half), (length, -half), (length, half), (0.0, half)


def _add_compass(axes: Axes) -> None:
    """Add a north arrow and a scale bar: a tenth to a third of the width, in round metres."""
    axes.annotate(
        'N', xy=(0.97, 0.95), xytext=(0, -34), xycoords='axes fraction', ha='center', va='center',
        textcoords='offset points', arrowprops={'arrowstyle': '-|>', 'color': 'black'},
    )
    low, high = axes.get_xlim()
    bar = max(step for step in (50, 100, 200, 500, 1000, 2000) if step <= (high - low) / 3)
    bottom = axes.get_ylim()[0]
    y = bottom + 0.05 * (axes.get_ylim()[1] - bottom)
    x = low + 0.04 * (high - low)
    axes.plot([x, x + bar], [y, y], color='black', linewidth=3, solid_capstyle='butt')
    axes.text(x + bar / 2, y, f'{bar} m\n', ha='center', va='bottom', fontsize=9)
