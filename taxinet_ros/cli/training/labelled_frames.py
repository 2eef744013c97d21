"""``taxinet camera compare``: a network on labelled frames, beside rendered ones."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from taxinet_ros.cli.options import PictureOption, ScenarioOption
from taxinet_ros.cli.show import print_json
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.analysis.camera.compare import Comparison, QuantityErrors
    from taxinet_ros.core.perception.perception import Perception


def compare(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar='DIR',
            help='folder of frames with labels.csv: image, cte_m, heading_error_deg (left '
            'positive), distance_m along the runway',
        ),
    ],
    perception: Annotated[
        str, typer.Option(help='taxinet (the shipped network) or a .safetensors weights file')
    ] = 'taxinet',
    distance_offset: Annotated[
        float,
        typer.Option(
            metavar='M',
            help='offset added to their distance_m to get ours; ours is measured from the '
            'threshold of runway 04 at 47.196736,-119.332917, that of the published ULI frames '
            'from 47.196890,-119.33260, 29.5 m farther on',
        ),
    ] = 0.0,
    settings: ScenarioOption = None,
    out: PictureOption = None,
    as_json: Annotated[
        bool, typer.Option('--json', help='print one JSON object with all frames')
    ] = False,
) -> None:
    """Measure the network on labelled frames, shown beside rendered frames of the same poses.

    Rendered frames have the light of the published ones, 9:04 under a clear sky, unless changed by
    --set.
    """
    from rich.progress import track

    from taxinet_ros.analysis.camera.compare import (
        compare_frames,
        comparison_scenes,
        comparison_sheet,
    )
    from taxinet_ros.analysis.camera.sheets import POSE
    from taxinet_ros.cli.training.pictures import new_picture, write_picture
    from taxinet_ros.core.perception.labelled_frames import read_labelled_frames
    from taxinet_ros.core.provenance import provenance
    from taxinet_ros.trials.options import read_settings

    if not math.isfinite(distance_offset):
        raise UsageError(f'--distance-offset {distance_offset}: must be a finite number of metres')
    values = read_settings(settings or ())
    for key in POSE:
        if key in values:
            raise UsageError(f'--set {key}: given by the labels of the frames; leave it out')
    frames = read_labelled_frames(folder)
    scenes = comparison_scenes(frames, values, distance_offset)
    path = new_picture(out, f'camera-compare-{folder.resolve().name}')
    network = _network(perception)
    notes = Console(stderr=True, highlight=False, soft_wrap=True)
    bar = track(frames, 'frames', console=notes, disable=not notes.is_terminal, transient=True)
    comparison = compare_frames(bar, network)
    write_picture(path, lambda: comparison_sheet(scenes, network, path))
    if as_json:
        head = {
            'folder': str(folder), 'perception': perception,
            'weights_sha256': network.fingerprint, 'distance_offset_m': distance_offset,
            'sheet': str(path), 'made_on': dict(provenance()),
        }
        print_json({**head, **comparison.to_dict()})
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
    from taxinet_ros.core.perception.perception import make_perception
    from taxinet_ros.core.scenario import Scenario

    perception = make_perception(word)
    if not perception.needs_image:
        raise UsageError(
            f'--perception {word}: uses no camera image; name taxinet or a weights file'
        )
    perception.begin(Scenario().rig)  # the frames are of the paper's camera
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
