"""Our camera against another renderer: edges of paint and shadow in pixels, light by the hour.

Mitsuba, which has to be installed, or FlightGear, which has to run (``taxinet flightgear start``).
Writes a figure. Exit code 1 if a scene misses the aim of 1 px beyond 8 m, 3 if one shows too little
paint to tell.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from common import leave, one_of, options, page_console

import mitsuba_scene
import opinions
from opinions import AIM_PX, NEAR_M, SURFACES, LightCurves, SceneOpinion, plot_opinion
from rich.console import Console
from rich.progress import track
from rich.table import Table

from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.trials.options import read_settings

OTHERS = {'mitsuba': 'Mitsuba', 'flightgear': 'FlightGear'}
"""Renderers, and their names in figures."""
Watch = Callable[[Iterable[Scenario]], Iterable[Scenario]]


def compare(
    against: str, values: Mapping[str, object], watched: Watch
) -> tuple[list[SceneOpinion], LightCurves]:
    """Compare our camera with a renderer, with some values set in all scenes.

    Raises:
        UsageError: it is not there, or does not show what is set.
        InfraError: FlightGear does not run, or failed.
    """
    if against == 'mitsuba':
        chosen, day = opinions.scenes(values), opinions.light_scenes(values)
        mitsuba_scene.check_installed()
        for scenario in (*chosen, *day):
            mitsuba_scene.check_shown(scenario)
        other: Any = opinions
    else:
        other = import_module('flightgear_opinion')
        chosen, day = other.scenes(values), other.light_scenes(values)
        for scenario in (*chosen, *day):
            other.check_running(scenario)
    found = [
        other.compare_scene(scenario, shown=number % 2 == 0)
        for number, scenario in enumerate(watched(chosen))
    ]
    return found, other.compare_light(day)


def show(found: Sequence[SceneOpinion], curves: LightCurves) -> None:
    """Print shifts of edges in pixels, ours minus theirs, and differences of light."""
    console = page_console()
    table = Table(
        'scene', 'edges', 'offset u, v', 'larger', 'median', '95 %', f'>{NEAR_M:g} m', box=None,
    )
    for one in found:
        scene = f'{find_place(one.scenario.place).name} {one.scenario.camera_model.name}'
        for kind, edges in (('paint', one.markings), ('shadow', one.shadow)):
            if edges is None:
                continue
            size = edges.summary()
            table.add_row(
                scene, f'{kind} {size["measured"]} of {size["edges"]}',
                f'{figure(size["offset_u_px"], "+.2f")} {figure(size["offset_v_px"], "+.2f")}',
                figure(size['growth_px'], '+.2f'), figure(size['median_px']),
                figure(size['p95_px']), figure(size['p95_beyond_8_m_px']),
            )
    console.print(table)
    light = Table('light, sun above 10°', 'greatest difference over the day, stops', box=None)
    for surface in SURFACES:
        light.add_row(surface, figure(curves.greatest_ev(surface)))
    console.print(light)


def figure(value: float | None, form: str = '.2f') -> str:
    """A number of a table, '-' if there is none."""
    return '-' if value is None else format(value, form)


def main(words: Sequence[str] | None = None) -> int:
    """Compare, write the figure and print."""
    parser = options(__doc__)
    parser.add_argument('against', type=one_of(OTHERS), metavar='|'.join(OTHERS))
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                        help='value of all scenes, but for time_of_day and shadows, which vary')
    parser.add_argument('--out', type=Path, metavar='FILE.png',
                        help='figure (default: second-opinion-RENDERER.png here)')
    given = parser.parse_args(words)
    values = read_settings(given.set)
    for key in ('time_of_day_h', 'shadows'):
        if key in values:
            raise UsageError(f'--set {key}: varies over the comparison; leave it out')
    path = given.out or Path(f'second-opinion-{given.against}.png')
    notes = Console(stderr=True, highlight=False, soft_wrap=True)

    def watched(chosen: Iterable[Scenario]) -> Iterable[Scenario]:
        off = not notes.is_terminal
        return track(list(chosen), 'scenes', console=notes, disable=off, transient=True)

    found, curves = compare(given.against, values, watched)
    try:
        plot_opinion(found, curves, path, OTHERS[given.against])
    except OSError as error:
        raise UsageError(f'{path}: cannot be written: {error.strerror}') from error
    missed, unclear = (sum(one.meets_aim is word for one in found) for word in (False, None))
    if given.json:
        print(json.dumps({
            'against': given.against, 'figure': str(path), 'missed_aim': missed,
            'unclear': unclear, 'scenes': [one.to_dict() for one in found],
            'light': curves.to_dict(), 'made_on': dict(provenance()),
        }, indent=2, allow_nan=False))
    else:
        show(found, curves)
        print(f'{len(found)} scenes, {missed} with more than {AIM_PX:g} px in 5 % of the edges of '
              f'paint beyond {NEAR_M:g} m, {unclear} with too few edges to tell')
        print(f'figure: {path}')
    return ExitCode.VIOLATED if missed else ExitCode.INCOMPLETE if unclear else ExitCode.OK


if __name__ == '__main__':
    leave(main)
