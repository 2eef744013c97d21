"""The commands about the network: ``taxinet train``, ``dataset`` and ``evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.option_types import (
    PerceptionOption,
    PicturesArgument,
    ScenarioArgument,
    SeedOption,
    VariedOption,
)


def train(
    out: Annotated[Path, typer.Option(help='weights file to write, NAME.safetensors')],
    program: PicturesArgument = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(help='folder of labelled images, instead of a program; repeatable'),
    ] = None,
    images: Annotated[int, typer.Option(help='pictures to render, one per scene')] = 12_000,
    validation: Annotated[int, typer.Option(help='further ones held back to measure on')] = 1_500,
    validation_data: Annotated[
        Path | None, typer.Option(help='folder of images to measure on, instead')
    ] = None,
    sampler: Annotated[
        str, typer.Option(help='how scenes are drawn: random, halton, sobol or grid')
    ] = 'random',
    validation_program: Annotated[
        str | None, typer.Option(help='program of the scenes held back, instead')
    ] = None,
    add: Annotated[
        list[str] | None,
        typer.Option(metavar='PROGRAM=COUNT', help='add scenes of another program; repeatable'),
    ] = None,
    add_runs: Annotated[
        list[str] | None,
        typer.Option(
            metavar='CAMPAIGN=COUNT',
            help="add places on the way of a campaign's failed runs; repeatable",
        ),
    ] = None,
    start: Annotated[
        str | None, typer.Option(help='weights to begin from, word or file; else fresh ones')
    ] = None,
    varied: VariedOption = False,
    augment: Annotated[
        bool, typer.Option('--augment', help='change exposure, focus, noise at every look')
    ] = False,
    epochs: Annotated[int, typer.Option(help='times that every picture is seen')] = 20,
    batch: Annotated[int, typer.Option(help='pictures per step')] = 64,
    learning_rate: Annotated[float, typer.Option(help='highest of the schedule')] = 3e-3,
    patience: Annotated[
        int,
        typer.Option(
            help='stop after so many epochs without gain, 0 never; the best epoch is kept anyway, '
            'and most of the gain comes at the end of the schedule'
        ),
    ] = 0,
    seed: Annotated[int, typer.Option(help='of everything random')] = 1,
    workers: Annotated[int, typer.Option(help='processes that render')] = 2,
    overwrite: Annotated[bool, typer.Option('--overwrite', help='replace what is there')] = False,
) -> None:
    """Train TaxiNet on rendered scenes or labelled images.

    Writes weights, model card and learning curves.
    """
    from taxinet_ros.cli.train import run_train
    from taxinet_ros.training.options import TrainOptions
    from taxinet_ros.training.portions import parse_portion

    run_train(TrainOptions(
        program=program, data=tuple(data or ()), validation_data=validation_data, out=out,
        sampler=sampler, validation_program=validation_program, start=start,
        add=(
            *(parse_portion(text, 'program') for text in add or ()),
            *(parse_portion(text, 'runs') for text in add_runs or ()),
        ),
        images=images, validation=validation, varied=varied, augment=augment, epochs=epochs,
        batch=batch, learning_rate=learning_rate, patience=patience, seed=seed, workers=workers,
        overwrite=overwrite,
    ))


def dataset(
    program: ScenarioArgument,
    out: Annotated[Path, typer.Option(help='folder for images and labels; must be new')],
    count: Annotated[int, typer.Option(help='images, one per scene')],
    sampler: Annotated[
        str, typer.Option(help='how scenes are drawn: random, halton, sobol or grid')
    ] = 'random',
    seed: SeedOption = 0,
    varied: VariedOption = False,
    workers: Annotated[int, typer.Option(help='processes that render')] = 2,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue what was interrupted')
    ] = False,
) -> None:
    """Render labelled images of scenes, to train on."""
    from taxinet_ros.cli.dataset import run_dataset
    from taxinet_ros.training.folder import DatasetOptions

    run_dataset(DatasetOptions(
        program=program, out=out, count=count, sampler=sampler, seed=seed, varied=varied,
        workers=workers, resume=resume,
    ))


def evaluate(
    program: PicturesArgument = None,
    data: Annotated[
        Path | None, typer.Option(help='folder of labelled images, instead of a program')
    ] = None,
    perception: PerceptionOption = 'taxinet',
    images: Annotated[int, typer.Option(help='pictures to render, one per scene')] = 2_000,
    seed: Annotated[
        int, typer.Option(min=0, help='of the scenes; another than that of the training')
    ] = 2,
    workers: Annotated[int, typer.Option(help='processes that render')] = 2,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
) -> None:
    """Measure a network's errors on single frames.

    On rendered scenes by light and place, or on a folder of labelled images.
    """
    from taxinet_ros.cli.evaluate import run_evaluate

    run_evaluate(
        program, data, perception=perception, images=images, seed=seed, workers=workers,
        as_json=as_json,
    )
