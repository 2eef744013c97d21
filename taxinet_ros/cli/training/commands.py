"""``taxinet train``, ``dataset``, ``evaluate`` and ``camera``: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.completion import complete_setting, one_of
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import (
    AircraftOption,
    AirportOption,
    AptDatOption,
    CameraOption,
    PerceptionOption,
    PictureOption,
    PicturesArgument,
    RendererOption,
    RunwayOption,
    ScenarioArgument,
    SeedOption,
    VariedOption,
    refuse_given,
    renderer_of,
    scene_settings,
)
from taxinet_ros.errors import UsageError


def train(
    context: typer.Context,
    out: Annotated[
        Path,
        typer.Option(
            metavar='NAME.safetensors', writable=True, dir_okay=False, help='weights file to write'
        ),
    ],
    program: PicturesArgument = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(help='folder of labelled images instead of a program; repeatable'),
    ] = None,
    images: Annotated[int, typer.Option(help='images to render, one per scene')] = 12_000,
    validation: Annotated[
        int, typer.Option(
            help='additional validation images; what is added brings more, in proportion'
        )
    ] = 1_500,
    validation_data: Annotated[
        Path | None, typer.Option(help='folder of validation images, instead')
    ] = None,
    sampler: Annotated[
        str, typer.Option(help='how scenes are drawn: random, halton, sobol or grid')
    ] = 'random',
    validation_program: Annotated[
        str | None, typer.Option(help='program of the validation scenes, instead')
    ] = None,
    add: Annotated[
        list[str] | None,
        typer.Option(metavar='PROGRAM=COUNT', help='add scenes of another program; repeatable'),
    ] = None,
    add_runs: Annotated[
        list[str] | None,
        typer.Option(
            metavar='CAMPAIGN=COUNT',
            help="add positions along the paths of a campaign's failed runs; repeatable",
        ),
    ] = None,
    start: Annotated[
        str | None, typer.Option(help='initial weights, word or file (default: random)')
    ] = None,
    varied: VariedOption = False,
    augment: Annotated[
        bool,
        typer.Option(
            '--augment', help='augment images: random exposure, focus and noise at each use'
        ),
    ] = False,
    epochs: Annotated[int, typer.Option(help='epochs')] = 20,
    batch: Annotated[int, typer.Option(help='batch size')] = 64,
    learning_rate: Annotated[float, typer.Option(help='maximum learning rate of the '
    'schedule')] = 3e-3,
    patience: Annotated[
        int,
        typer.Option(
            help='stop after this many epochs without improvement (0: never); the best epoch is '
            'kept anyway, and most of the improvement comes at the end of the schedule'
        ),
    ] = 0,
    seed: Annotated[int, typer.Option(help='random seed')] = 1,
    workers: Annotated[int, typer.Option(help='rendering processes')] = 2,
    overwrite: Annotated[bool, typer.Option('--overwrite', help='overwrite existing '
    'output')] = False,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue an interrupted command')
    ] = False,
) -> None:
    """Train TaxiNet on rendered scenes or labelled images.

    Writes weights, model card and learning curves; until then NAME.part, for --resume.
    """
    from taxinet_ros.cli.training.network import run_train
    from taxinet_ros.training.data.portions import parse_portion
    from taxinet_ros.training.options import TrainOptions

    if data and program is None:
        why = 'for rendered scenes; with --data every image is used, leave it out'
        refuse_given(context, ('images', 'sampler'), why)
    if validation_data is not None:
        why = 'with --validation-data all of its images are used; leave one out'
        refuse_given(context, ('validation',), why)
    run_train(TrainOptions(
        program=program, data=tuple(data or ()), validation_data=validation_data, out=out,
        sampler=sampler, validation_program=validation_program, start=start,
        add=(
            *(parse_portion(text, 'program') for text in add or ()),
            *(parse_portion(text, 'runs') for text in add_runs or ()),
        ),
        images=images, validation=validation, varied=varied, augment=augment, epochs=epochs,
        batch=batch, learning_rate=learning_rate, patience=patience, seed=seed, workers=workers,
        overwrite=overwrite, resume=resume,
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
    camera: RendererOption = 'ours',
    workers: Annotated[int, typer.Option(help='rendering processes')] = 2,
    resume: Annotated[
        bool, typer.Option('--resume', help='continue an interrupted command')
    ] = False,
) -> None:
    """Render labelled training images of scenes."""
    from taxinet_ros.cli.training.network import run_dataset
    from taxinet_ros.training.data.dataset_folder import DatasetOptions

    run_dataset(DatasetOptions(
        program=program, out=out, count=count, sampler=sampler, seed=seed, varied=varied,
        camera=camera, workers=workers, resume=resume,
    ))


def evaluate(
    context: typer.Context,
    program: PicturesArgument = None,
    data: Annotated[
        Path | None, typer.Option(help='folder of labelled images instead of a program')
    ] = None,
    perception: PerceptionOption = 'taxinet',
    images: Annotated[int, typer.Option(help='images to render, one per scene')] = 2_000,
    seed: Annotated[
        int, typer.Option(min=0, help='seed of the scenes; must differ from that of the training')
    ] = 2,
    camera: RendererOption = 'ours',
    workers: Annotated[int, typer.Option(help='rendering processes')] = 2,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
) -> None:
    """Measure a network's errors on single frames.

    On rendered scenes, by light and position, or on a folder of labelled images.
    """
    from taxinet_ros.cli.training.network import run_evaluate

    if data is not None and program is None:
        why = 'for rendered scenes; with --data every image is read in order, leave it out'
        refuse_given(context, ('images', 'seed', 'camera', 'workers'), why)
    run_evaluate(
        program, data, perception=perception, images=images, seed=seed, workers=workers,
        as_json=as_json, camera=camera,
    )


camera_app = command_group('Render camera frames, and compare them with labelled images.')
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        '--set', metavar='KEY=VALUE',
        help='a scenario value (cross_track_m=-3, heading_deg=10, distance_m=900, '
        'time_of_day_h=16, clouds=broken, rain_percent=50, shadows=off, date=2020-06-21, …); '
        'repeatable',
        autocompletion=complete_setting,
    ),
]


@camera_app.command('list')
def list_cameras() -> None:
    """List the shipped cameras."""
    from taxinet_ros.cli.training.rig import print_cameras

    print_cameras()


@camera_app.command('show')
def show_camera(
    camera: Annotated[
        str, typer.Argument(metavar='CAMERA', help='shipped name, or YAML file of one')
    ],
    aircraft: AircraftOption = None,
    out: PictureOption = None,
    yaml: Annotated[
        Path | None,
        typer.Option(
            '--yaml', metavar='FILE.yaml', writable=True, dir_okay=False,
            help='also write it as a YAML file, to be changed; must be new',
        ),
    ] = None,
) -> None:
    """Describe a camera, and draw what it sees on an aircraft and where it looks."""
    from taxinet_ros.cli.training.rig import show_camera

    show_camera(camera, aircraft, out, yaml)


@camera_app.command()
def frame(
    settings: SetOption = None,
    airport: AirportOption = None,
    runway: RunwayOption = None,
    apt_dat: AptDatOption = None,
    aircraft: AircraftOption = None,
    camera: CameraOption = None,
    out: PictureOption = None,
) -> None:
    """Render the first camera frame of a run of one scene, as large as its camera makes it."""
    from taxinet_ros.cli.training.camera import save_frame

    save_frame(
        scene_settings(settings, airport, runway, apt_dat, aircraft, camera), out,
        camera=renderer_of(camera) or 'ours',
    )


@camera_app.command()
def sheet(
    hours: Annotated[str, typer.Option(help='local hours, e.g. 6,6.5,7; one column each')] = '',
    clouds: Annotated[str, typer.Option(help='cloud kinds, e.g. clear,broken; one row each')] = '',
    rain: Annotated[
        str, typer.Option(help='rain in percent, e.g. 0,25,100; one row each under every rain '
        'cloud')
    ] = '',
    settings: SetOption = None,
    airport: AirportOption = None,
    runway: RunwayOption = None,
    apt_dat: AptDatOption = None,
    aircraft: AircraftOption = None,
    camera: CameraOption = None,
    out: PictureOption = None,
) -> None:
    """Render one pose at many hours and skies on one contact sheet."""
    from taxinet_ros.cli.training.camera import save_sheet

    save_sheet(
        hours=hours, clouds=clouds, rain=rain,
        settings=scene_settings(settings, airport, runway, apt_dat, aircraft, camera), out=out,
        camera=renderer_of(camera) or 'ours',
    )


@camera_app.command()
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
    settings: SetOption = None,
    out: PictureOption = None,
    json: Annotated[
        bool, typer.Option('--json', help='print one JSON object with all frames')
    ] = False,
) -> None:
    """Measure the network on labelled frames, shown beside rendered frames of the same poses.

    Rendered frames have the light of the published ones, 9:04 under a clear sky, unless changed by
    --set.
    """
    from taxinet_ros.cli.training.camera import run_compare

    run_compare(
        folder, perception=perception, distance_offset_m=distance_offset,
        settings=settings or (), out=out, json_wanted=json,
    )


network_app = command_group('Networks of others: convert them, and see what they see.')


@network_app.command('from-nnet')
def from_nnet(
    file: Annotated[Path, typer.Argument(metavar='FILE.nnet', help="network in Stanford's format")],
    out: Annotated[
        Path,
        typer.Option(
            metavar='NAME.onnx', writable=True, dir_okay=False,
            help='network to write, with its description NAME.yaml; must be new',
        ),
    ],
    description: Annotated[
        str,
        typer.Option(
            metavar='NAME|FILE.yaml', autocompletion=one_of('tinytaxinet'),
            help='what its inputs and outputs are, which the file does not say: tinytaxinet, as '
            'of the public TinyTaxiNet, or a YAML file as in docs/onnx.md',
        ),
    ],
) -> None:
    """Convert a .nnet file to ONNX, which `--perception NAME.onnx` then takes.

    With the normalisation of the file. Its answers are compared with the file's own sums before
    anything is written.
    """
    from taxinet_ros.cli.training.foreign_network import convert_nnet

    convert_nnet(file, out, description)


@network_app.command('see')
def see(
    network: Annotated[Path, typer.Argument(metavar='NETWORK.onnx', help='an ONNX network')],
    settings: SetOption = None,
    airport: AirportOption = None,
    runway: RunwayOption = None,
    apt_dat: AptDatOption = None,
    aircraft: AircraftOption = None,
    camera: CameraOption = None,
    out: PictureOption = None,
) -> None:
    """Draw what an ONNX network gets to see of a scene's first frame, and print its answer."""
    from taxinet_ros.cli.training.foreign_network import show_network_view

    if renderer_of(camera):
        raise UsageError(f'--camera {camera}: only our own camera draws here; name a mounted one')
    show_network_view(
        network, scene_settings(settings, airport, runway, apt_dat, aircraft, camera), out
    )
