"""``taxinet camera``: look through the camera, and compare its pictures with those of others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

camera_app = typer.Typer(
    rich_markup_mode=None,
    help='Look through the wing camera, compare its frames.',
)

SetOption = Annotated[
    list[str] | None,
    typer.Option(
        '--set', metavar='KEY=VALUE',
        help='a scenario value (cross_track=-3, heading=10, distance=900, time_of_day=16, '
        'clouds=broken, rain=50, shadows=off, date=2020-06-21, …); repeatable',
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
    from taxinet_ros.cli.camera_pictures import save_frame

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
    from taxinet_ros.cli.camera_pictures import save_sheet

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
    from taxinet_ros.cli.camera_pictures import print_shadow

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
    from taxinet_ros.cli.camera_compare import run_compare

    run_compare(
        folder, perception=perception, distance_offset_m=distance_offset,
        settings=settings or (), out=out, json_wanted=json,
    )
