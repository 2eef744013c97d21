"""``taxinet train``, ``dataset``, ``evaluate`` and ``camera``: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import (
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
        bool,
        typer.Option(
            '--augment', help='change exposure, focus and noise each time a picture is used'
        ),
    ] = False,
    epochs: Annotated[int, typer.Option(help='passes over the training pictures')] = 20,
    batch: Annotated[int, typer.Option(help='pictures per step')] = 64,
    learning_rate: Annotated[float, typer.Option(help='highest of the schedule')] = 3e-3,
    patience: Annotated[
        int,
        typer.Option(
            help='stop after so many epochs without gain, 0 never; the best epoch is kept anyway, '
            'and most of the gain comes at the end of the schedule'
        ),
    ] = 0,
    seed: Annotated[int, typer.Option(help='seed of all random choices')] = 1,
    workers: Annotated[int, typer.Option(help='processes that render')] = 2,
    overwrite: Annotated[bool, typer.Option('--overwrite', help='replace what is there')] = False,
) -> None:
    """Train TaxiNet on rendered scenes or labelled images.

    Writes weights, model card and learning curves.
    """
    from taxinet_ros.cli.training.network import run_train
    from taxinet_ros.training.data.portions import parse_portion
    from taxinet_ros.training.options import TrainOptions

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
    from taxinet_ros.cli.training.network import run_dataset
    from taxinet_ros.training.data.dataset_folder import DatasetOptions

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
    from taxinet_ros.cli.training.network import run_evaluate

    run_evaluate(
        program, data, perception=perception, images=images, seed=seed, workers=workers,
        as_json=as_json,
    )


camera_app = typer.Typer(
    rich_markup_mode=None,
    help='Render camera frames, and compare them with labelled ones.',
)
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        '--set', metavar='KEY=VALUE',
        help='a scenario value (cross_track_m=-3, heading_deg=10, distance_m=900, '
        'time_of_day_h=16, clouds=broken, rain_percent=50, shadows=off, date=2020-06-21, …); '
        'repeatable',
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        metavar='FILE.png',
        help='picture to write, which must be new; without it, a new one below bags/',
    ),
]


@camera_app.callback(invoke_without_command=True)
def _camera(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


@camera_app.command()
def frame(settings: SetOption = None, out: OutOption = None) -> None:
    """Photograph one scene: the first frame of a run of it, 360x200."""
    from taxinet_ros.cli.training.camera import save_frame

    save_frame(settings or (), out)


@camera_app.command()
def sheet(
    hours: Annotated[str, typer.Option(help='local hours, as 6,6.5,7; a column each')] = '',
    clouds: Annotated[str, typer.Option(help='cloud kinds, as clear,broken; a row each')] = '',
    rain: Annotated[
        str, typer.Option(help='rain in percent, as 0,25,100; a row each under every rain cloud')
    ] = '',
    settings: SetOption = None,
    out: OutOption = None,
) -> None:
    """Photograph one pose at many hours under many skies, on one sheet."""
    from taxinet_ros.cli.training.camera import save_sheet

    save_sheet(hours=hours, clouds=clouds, rain=rain, settings=settings or (), out=out)


@camera_app.command()
def shadow(
    hours: Annotated[
        str, typer.Option(help='local hours, as 13,15.5; each a line')
    ] = '12,12.5,13,13.5,14,15,16,17,17.5',
    turbidity: Annotated[
        float, typer.Option(help="Linke's, of the clear day compared with: 3.3 is the place's in "
                            'March, 2 very clear, 5 hazy', min=1.5, max=10.0)
    ] = 3.3,
    settings: SetOption = None,
) -> None:
    """Tell when the aircraft's own shadow is in the picture, how dark it is, and what physics says.

    In the first frame of a run under a clear sky, unless --set says otherwise. The ratios are of
    light, shaded ground over sunlit ground: 0 is black, 1 no shadow at all.
    """
    from taxinet_ros.cli.training.camera import print_shadow

    print_shadow(hours=hours, turbidity=turbidity, settings=settings or ())


@camera_app.command()
def compare(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar='DIR',
            help='frames and their labels.csv: image, cte_m, heading_error_deg (left positive), '
            'distance_m along the runway',
        ),
    ],
    perception: Annotated[
        str, typer.Option(help='taxinet (the shipped network) or a .safetensors weights file')
    ] = 'taxinet',
    distance_offset: Annotated[
        float,
        typer.Option(
            metavar='M',
            help='our distance is theirs plus this; ours counts from the threshold of runway 04 '
            'at 47.196736,-119.332917, the published ULI frames count from '
            '47.196890,-119.33260: 29.5 m farther on',
        ),
    ] = 0.0,
    settings: SetOption = None,
    out: OutOption = None,
    json: Annotated[
        bool, typer.Option('--json', help='print one JSON object with all frames instead')
    ] = False,
) -> None:
    """Measure the network on labelled frames, and picture them beside ours of the same poses.

    Our pictures have the light of the published frames, 9:04 under a clear sky, unless --set says
    otherwise.
    """
    from taxinet_ros.cli.training.camera import run_compare

    run_compare(
        folder, perception=perception, distance_offset_m=distance_offset,
        settings=settings or (), out=out, json_wanted=json,
    )
