"""``taxinet camera``: frames, contact sheets, and comparison with labelled frames."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from pathlib import Path

from PIL import Image
from rich.console import Console
from rich.progress import track
from rich.table import Table

from taxinet_ros.analysis.camera.compare import (
    Comparison,
    QuantityErrors,
    compare_frames,
    comparison_scenes,
    comparison_sheet,
)
from taxinet_ros.analysis.camera.sheets import (
    HOURS,
    POSE,
    camera_sheet,
    scene_picture,
    sheet_scenes,
)
from taxinet_ros.cli.checked import tell_doubts
from taxinet_ros.core.camera.airframe import covering_doubts
from taxinet_ros.core.perception.labelled_frames import read_labelled_frames
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.scenario_fields import CLOUDS, RAIN_CLOUDS
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.options import DEFAULT_ROOT, read_settings

SUFFIX = '.png'
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
