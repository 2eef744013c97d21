"""``taxinet camera``: frames, contact sheets, shadows, and comparison with labelled frames."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from PIL import Image
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

from taxinet_ros.analysis.camera import second_opinion
from taxinet_ros.analysis.camera.compare import (
    Comparison,
    QuantityErrors,
    compare_frames,
    comparison_scenes,
    comparison_sheet,
)
from taxinet_ros.analysis.camera.mitsuba_scene import check_installed, check_shown
from taxinet_ros.analysis.camera.second_opinion import (
    AIM_PX,
    NEAR_M,
    SURFACES,
    LightCurves,
    SceneOpinion,
    plot_opinion,
)
from taxinet_ros.analysis.camera.shadow import shadow_appearances
from taxinet_ros.analysis.camera.sheets import (
    HOURS,
    POSE,
    camera_sheet,
    scene_picture,
    sheet_scenes,
)
from taxinet_ros.campaign.options import DEFAULT_ROOT, read_settings
from taxinet_ros.cli.checked import tell_doubts
from taxinet_ros.core.camera.airframe import covering_doubts
from taxinet_ros.core.perception.labelled_frames import read_labelled_frames
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.place.catalogue import find_place
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS, clock_words
from taxinet_ros.errors import ExitCode, UsageError

SUFFIX = '.png'
OTHERS = {'mitsuba': 'Mitsuba', 'flightgear': 'FlightGear'}
"""Renderers that ours can be compared with, and their names in figures."""
_AXES = {'time_of_day_h': '--hours', 'clouds': '--clouds', 'rain_percent': '--rain'}


def save_frame(settings: Iterable[str], out: Path | None, camera: str = OURS) -> None:
    """Write the frame of one scene and print its path.

    Raises:
        UsageError: bad settings, a camera that cannot show them, or a file that cannot be written.
        InfraError: the camera failed.
    """
    scene = scenario_from_human(read_settings(settings))
    path = new_picture(out, 'camera-frame')
    write_picture(path, lambda: Image.fromarray(scene_picture(scene, camera)).save(path))
    print(f'picture: {path}')
    tell_doubts(covering_doubts(scene.aircraft_model, scene.camera_model))


def save_sheet(
    *, hours: str, clouds: str, rain: str, settings: Iterable[str], out: Path | None,
    camera: str = OURS,
) -> None:
    """Write the sheet of one pose and print its path.

    Raises:
        UsageError: bad settings, a camera that cannot show them, or a file that cannot be written.
        InfraError: the camera failed.
    """
    values = read_settings(settings)
    for key, option in _AXES.items():
        if key in values:
            raise UsageError(f'--set {key}: varies over the sheet; use {option} {values[key]}')
    columns = _numbers('--hours', hours) or HOURS
    rains = _numbers('--rain', rain) or (0.0,)
    kinds = _words(clouds) or (RAIN_CLOUDS if rain else CLOUDS)
    scenes = sheet_scenes(values, columns, kinds, rains)
    path = new_picture(out, 'camera-sheet')
    write_picture(path, lambda: camera_sheet(scenes, path, camera))
    print(f'sheet: {path}')


def print_shadow(*, hours: str, turbidity: float, settings: Iterable[str]) -> None:
    """Print the appearance of the aircraft's own shadow, hour by hour.

    Raises:
        UsageError: bad settings or hours.
    """
    values = read_settings(settings)
    for key, mend in {'time_of_day_h': 'use --hours', 'shadows': 'leave it out'}.items():
        if key in values:
            raise UsageError(f'--set {key}: varies over the table; {mend}')
    columns = _numbers('--hours', hours)
    if not columns:
        raise UsageError(f'--hours {hours!r}: expected comma-separated numbers, e.g. 13,15.5')
    print("       sun        sun from  picture    in picture  renderer's  clear day:  its")
    print('time   elevation  the nose  in shadow  rendered    light       luminance   energy')
    for one in shadow_appearances(values, columns, turbidity):
        print(
            f'{clock_words(one.hour)}  {one.elevation_deg:7.1f}°  {one.from_nose_deg:6.0f}°  '
            f'{100 * one.share:8.1f}%  {_ratio(one.rendered)}       {_ratio(one.light)}       '
            f'{_ratio(one.physics)}       {_ratio(one.energy)}'
        )


def _ratio(value: float) -> str:
    return '    -' if math.isnan(value) else f'{value:5.3f}'


def new_picture(out: Path | None, stem: str) -> Path:
    """Path of a new picture: ``out``, or one below ``bags/`` named ``stem``.

    Raises:
        UsageError: ``out`` exists, is not a PNG name, or its folder does not exist.
    """
    if out is None:
        return _next_free(DEFAULT_ROOT / f'{stem}{SUFFIX}')
    if out.suffix.lower() != SUFFIX:
        raise UsageError(f'--out {out}: pictures are PNG files; use {out.stem}{SUFFIX}')
    if out.exists() or out.is_symlink():
        raise UsageError(f'--out {out}: already exists and is not overwritten; choose a new name')
    if not out.parent.is_dir():
        raise UsageError(f'--out {out}: no such folder: {out.parent}; make it first')
    return out


def _next_free(wanted: Path) -> Path:
    """First path of ``wanted``, ``NAME-2.png``, ``NAME-3.png``, … that does not exist."""
    candidate, number = wanted, 1
    while candidate.exists() or candidate.is_symlink():
        number += 1
        candidate = wanted.with_stem(f'{wanted.stem}-{number}')
    return candidate


def write_picture(path: Path, save: Callable[[], object]) -> None:
    """Call ``save``, which writes ``path``; the default folder is made first.

    Raises:
        UsageError: the file cannot be written.
    """
    try:
        if path.parent == DEFAULT_ROOT:
            path.parent.mkdir(exist_ok=True)
        save()
    except OSError as error:
        raise UsageError(f'{path}: cannot be written: {error.strerror or error}') from error


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(',') if word.strip())


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in _words(text))
    except ValueError:
        raise UsageError(
            f'{option} {text!r}: expected comma-separated numbers, e.g. 6,6.5,7'
        ) from None


def run_compare(
    folder: Path, *, perception: str, distance_offset_m: float, settings: Iterable[str],
    out: Path | None, json_wanted: bool,
) -> None:
    """Measure, write the sheet, and print the results.

    Raises:
        UsageError: bad folder, labels, pictures, settings, perception or output file.
    """
    if not math.isfinite(distance_offset_m):
        raise UsageError(
            f'--distance-offset {distance_offset_m}: must be a finite number of metres'
        )
    values = read_settings(settings)
    for key in POSE:
        if key in values:
            raise UsageError(f'--set {key}: given by the labels of the frames; leave it out')
    frames = read_labelled_frames(folder)
    scenes = comparison_scenes(frames, values, distance_offset_m)
    path = new_picture(out, f'camera-compare-{folder.resolve().name}')
    network = _network(perception)
    notes = Console(stderr=True, highlight=False, soft_wrap=True)
    bar = track(frames, 'frames', console=notes, disable=not notes.is_terminal, transient=True)
    comparison = compare_frames(bar, network)
    write_picture(path, lambda: comparison_sheet(scenes, network, path))
    if json_wanted:
        head = {
            'folder': str(folder), 'perception': perception,
            'weights_sha256': network.fingerprint, 'distance_offset_m': distance_offset_m,
            'sheet': str(path), 'made_on': dict(provenance()),
        }
        print(json.dumps({**head, **comparison.to_dict()}, indent=2, allow_nan=False))
        notes.print(f'sheet: {path}')
        return
    console = Console(highlight=False, soft_wrap=True)
    console.print(comparison_table(comparison))
    console.print(
        f'{len(comparison.frames)} frames, {comparison.without_estimate} without estimate; '
        f'perception {perception}, weights {network.fingerprint[:12]}'
    )
    console.print(f'sheet: {path}')


def run_second_opinion(
    against: str, *, settings: Iterable[str], out: Path | None, json_wanted: bool
) -> ExitCode:
    """Compare our camera with another renderer, write the figure, and print the results.

    Returns:
        1 if a scene misses the aim, 3 if one shows too little paint to tell, else 0.

    Raises:
        UsageError: an unknown renderer, one that is not installed, bad settings or output file.
        InfraError: FlightGear does not run, or failed.
    """
    if against not in OTHERS:
        raise UsageError(f'--against {against}: unknown; known: {", ".join(OTHERS)}')
    values = read_settings(settings)
    for key in ('time_of_day_h', 'shadows'):
        if key in values:
            raise UsageError(f'--set {key}: varies over the comparison; leave it out')
    notes = Console(stderr=True, highlight=False, soft_wrap=True)

    def watched(chosen: Iterable[Scenario]) -> Iterable[Scenario]:
        off = not notes.is_terminal
        return track(list(chosen), 'scenes', console=notes, disable=off, transient=True)

    compare = _with_mitsuba if against == 'mitsuba' else _with_flightgear
    path, opinions, curves = compare(values, out, watched)
    write_picture(path, lambda: plot_opinion(opinions, curves, path, OTHERS[against]))
    missed, unclear = (
        sum(one.meets_aim is word for one in opinions) for word in (False, None)
    )
    code = ExitCode.VIOLATED if missed else ExitCode.INCOMPLETE if unclear else ExitCode.OK
    if json_wanted:
        print(json.dumps({
            'against': against, 'figure': str(path), 'missed_aim': missed, 'unclear': unclear,
            'scenes': [one.to_dict() for one in opinions], 'light': curves.to_dict(),
            'made_on': dict(provenance()),
        }, indent=2, allow_nan=False))
        notes.print(f'figure: {path}')
        return code
    console = Console(highlight=False, soft_wrap=True)
    console.print(_opinion_table(opinions))
    console.print(_light_table(curves))
    console.print(
        f'{len(opinions)} scenes, {missed} with more than {AIM_PX:g} px in 5 % of the edges of '
        f'paint beyond {NEAR_M:g} m, {unclear} with too few edges to tell'
    )
    console.print(f'figure: {path}')
    return code


_Compared = tuple[Path, list[SceneOpinion], LightCurves]
_Watch = Callable[[Iterable[Scenario]], Iterable[Scenario]]


def _with_mitsuba(values: Mapping[str, object], out: Path | None, watched: _Watch) -> _Compared:
    chosen, day = second_opinion.scenes(values), second_opinion.light_scenes(values)
    check_installed()
    for scenario in (*chosen, *day):
        check_shown(scenario)
    path = new_picture(out, 'camera-compare-mitsuba')
    opinions = [
        second_opinion.compare_scene(scenario, shown=number % 2 == 0)
        for number, scenario in enumerate(watched(chosen))
    ]
    return path, opinions, second_opinion.compare_light(day)


def _with_flightgear(values: Mapping[str, object], out: Path | None, watched: _Watch) -> _Compared:
    from taxinet_ros.analysis.camera import flightgear_opinion

    chosen, day = flightgear_opinion.scenes(values), flightgear_opinion.light_scenes(values)
    path = new_picture(out, 'camera-compare-flightgear')
    for scenario in (*chosen, *day):
        flightgear_opinion.check_running(scenario)
    opinions = [
        flightgear_opinion.compare_scene(scenario, shown=number % 2 == 0)
        for number, scenario in enumerate(watched(chosen))
    ]
    return path, opinions, flightgear_opinion.compare_light(day)


def _opinion_table(opinions: Iterable[SceneOpinion]) -> Table:
    """Shifts of edges in pixels, ours minus theirs; the last three columns are of their sizes."""
    shown = Table(
        'scene', 'edges', 'offset u, v', 'larger', 'median', '95 %', f'>{NEAR_M:g} m',
        box=SIMPLE_HEAD, padding=0,
    )
    for one in opinions:
        scene = f'{find_place(one.scenario.place).name} {one.scenario.camera_model.name}'
        for kind, edges in (('paint', one.markings), ('shadow', one.shadow)):
            if edges is None:
                continue
            found = edges.summary()
            shown.add_row(
                scene, f'{kind} {found["measured"]} of {found["edges"]}',
                f'{_figure(found["offset_u_px"], "+.2f")} {_figure(found["offset_v_px"], "+.2f")}',
                _figure(found['growth_px'], '+.2f'), _figure(found['median_px']),
                _figure(found['p95_px']), _figure(found['p95_beyond_8_m_px']),
            )
    return shown


def _light_table(curves: LightCurves) -> Table:
    """Greatest differences of the light's curves over the day."""
    shown = Table(
        'light, sun above 10°', 'greatest difference over the day, stops', box=SIMPLE_HEAD,
    )
    for surface in SURFACES:
        shown.add_row(surface, _figure(curves.greatest_ev(surface)))
    return shown


def _network(word: str) -> Perception:
    perception = make_perception(word)
    if not perception.needs_image:
        raise UsageError(
            f'--perception {word}: uses no camera image; name taxinet or a weights file'
        )
    return perception


def comparison_table(comparison: Comparison) -> Table:
    """Table of the errors of both quantities, in display units."""
    shown = Table('error', 'MAE', '95 % interval', 'bias', 'correlation', 'mean predictor')
    _add_row(shown, 'cross-track, m', comparison.cte_m)
    _add_row(shown, 'heading, deg', comparison.heading_error_deg)
    return shown


def _add_row(shown: Table, name: str, errors: QuantityErrors) -> None:
    low, high = errors.mae_95 or (None, None)
    shown.add_row(
        name, _figure(errors.mae), f'{_figure(low)} to {_figure(high)}',
        _figure(errors.bias, '+.2f'), _figure(errors.correlation, '.3f'),
        _figure(errors.mean_predictor_mae),
    )


def _figure(value: float | None, form: str = '.2f') -> str:
    return '-' if value is None else format(value, form)
