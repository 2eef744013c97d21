"""``taxinet camera compare``: figures as a table or as JSON, and the sheet of pairs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from taxinet_ros.analysis.camera_compare import (
    Comparison,
    QuantityErrors,
    compare_frames,
    comparison_scenes,
    comparison_sheet,
)
from taxinet_ros.analysis.camera_sheet import POSE
from taxinet_ros.cli.camera_pictures import new_picture, read_settings, write
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.labelled_frames import read_labelled_frames
from taxinet_ros.core.perception import Perception, make_perception
from taxinet_ros.core.provenance import provenance


def run_compare(
    folder: Path, *, perception: str, distance_offset_m: float, settings: Iterable[str],
    out: Path | None, json_wanted: bool,
) -> None:
    """Measure, draw the sheet, and print what came of it.

    Raises:
        UsageError: bad folder, labels, pictures, settings, perception or output file.
    """
    if not math.isfinite(distance_offset_m):
        raise UsageError(f'--distance-offset {distance_offset_m}: expected a number of metres')
    values = read_settings(settings)
    for key in POSE:
        if key in values:
            raise UsageError(f'--set {key}: the labels of the frames say it; leave it out')
    frames = read_labelled_frames(folder)
    scenes = comparison_scenes(frames, values, distance_offset_m)
    path = new_picture(out, f'camera-compare-{folder.resolve().name}')
    network = _network(perception)
    notes = Console(stderr=True, highlight=False, soft_wrap=True)
    bar = track(frames, 'frames', console=notes, disable=not notes.is_terminal, transient=True)
    comparison = compare_frames(bar, network)
    write(path, lambda: comparison_sheet(scenes, network, path))
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
    console.print(table(comparison))
    console.print(
        f'{len(comparison.frames)} frames, {comparison.without_estimate} without estimate; '
        f'perception {perception}, weights {network.fingerprint[:12]}'
    )
    console.print(f'sheet: {path}')


def _network(word: str) -> Perception:
    perception = make_perception(word)
    if not perception.needs_image:
        raise UsageError(
            f'--perception {word}: does not look at pictures; name taxinet or a weights file'
        )
    return perception


def table(comparison: Comparison) -> Table:
    """The figures of both quantities, for people."""
    shown = Table('error', 'MAE', '95 % interval', 'bias', 'correlation', 'mean predictor')
    _add(shown, 'cross-track, m', comparison.cte_m)
    _add(shown, 'heading, deg', comparison.heading_error_deg)
    return shown


def _add(shown: Table, name: str, errors: QuantityErrors) -> None:
    low, high = errors.mae_95 or (None, None)
    shown.add_row(
        name, _figure(errors.mae), f'{_figure(low)} to {_figure(high)}',
        _figure(errors.bias, '+.2f'), _figure(errors.correlation, '.3f'),
        _figure(errors.mean_predictor_mae),
    )


def _figure(value: float | None, form: str = '.2f') -> str:
    return '-' if value is None else format(value, form)
