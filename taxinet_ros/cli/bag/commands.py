"""``taxinet bag``: inspect, check, repair, compare, replay and export bags of runs.

Exit codes: 0 the bag is whole, 2 bad input, or nothing in the bag can be
read, 3 something in it is lost or wrong, 4 no disk space for the output.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import OwnControllerOption, RunOption

BagArgument = Annotated[
    Path, typer.Argument(metavar='BAG', help='folder of a run, or an .mcap file')
]
JsonOption = Annotated[bool, typer.Option('--json', help='print one JSON object')]


def render(
    bag: BagArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar='NEW', help='folder for a new bag (default: add them to BAG itself)'),
    ] = None,
    run_id: RunOption = None,
) -> None:
    """Add camera frames to a bag recorded without them.

    The frames are bit-identical to those of the run: the aircraft is re-simulated from the recorded
    commands and checked against the recorded odometry. Under the same name, the new bag is
    byte-identical to one recorded with --images all.
    """
    from taxinet_ros.cli.bag.repair import run_render

    raise typer.Exit(run_render(bag, out, run_id))


def replay(
    bag: BagArgument,
    into: Annotated[
        str,
        typer.Option(metavar='NODE', help='perception, steering_controller or mtl_monitor'),
    ] = 'perception',
    run_id: RunOption = None,
    perception: Annotated[
        str | None,
        typer.Option(
            help="replaces the run's perception: a word, weights file, .onnx network or "
            'FILE.py:NAME'
        ),
    ] = None,
    controller: OwnControllerOption = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='new folder for plot and table (default: below bags/)'),
    ] = None,
    tolerance_cte: Annotated[
        float,
        typer.Option(
            metavar='M', help='tolerance of cross-track estimates; 0: bit-identical'
        ),
    ] = 0.0,
    tolerance_he: Annotated[
        float,
        typer.Option(
            metavar='DEG', help='tolerance of heading estimates; 0: bit-identical'
        ),
    ] = 0.0,
) -> None:
    """Replay a recorded run into one node and compare its outputs.

    Regression test for a retrained network. Missing frames are rendered. Exit code: 0 equal within
    the tolerances, 1 different, 2 bad input, 4 the node failed.
    """
    from taxinet_ros.cli.bag.input import readable_run
    from taxinet_ros.cli.bag.replay import ReplayOptions, run_replay

    with readable_run(bag, run_id) as whole:
        options = ReplayOptions(
            recording=whole, target=into, perception=perception, controller=controller, out=out,
            tolerance_cte_m=tolerance_cte, tolerance_he_deg=tolerance_he,
        )
        code = run_replay(options)
    raise typer.Exit(code)


def compare(
    bag: BagArgument,
    other: Annotated[Path, typer.Argument(metavar='OTHER', help='the bag to compare with')],
    tolerance: Annotated[
        float, typer.Option(help='tolerance of floating-point values; 0: bit-identical')
    ] = 0.0,
    skip: Annotated[
        list[str] | None,
        typer.Option(metavar='TOPIC', help='topic to leave out (camera/image_raw, …); repeatable'),
    ] = None,
    run_id: RunOption = None,
    other_run: Annotated[
        str | None,
        typer.Option(metavar='RUN_ID', help='which run of OTHER, if it holds several'),
    ] = None,
) -> None:
    """Find the first difference between two bags: topic, step and field.

    Run names are ignored. Exit code: 0 identical, 1 different, 2 bad input.
    """
    from taxinet_ros.cli.bag.compare import run_compare
    from taxinet_ros.cli.bag.input import one_run, readable_bags

    with readable_bags():
        bags = one_run(bag, run_id), one_run(other, other_run)
        code = run_compare(*bags, tolerance=tolerance, skip=skip or ())
    raise typer.Exit(code)


def golden(
    folder: Annotated[
        Path, typer.Argument(metavar='[DIR]', help='folder of bags', show_default=True)
    ] = Path('bags/golden'),
    update: Annotated[
        bool, typer.Option('--update', help='show the differences, then re-record the bags that '
        'differ')
    ] = False,
) -> None:
    """Rerun the scenes of the golden bags and compare, to see the effect of a change.

    On another processor or library version, values may differ slightly. Exit code: 0 identical, or
    updated with --update; 1 different.
    """
    from taxinet_ros.cli.bag.rerun import run_golden

    raise typer.Exit(run_golden(folder, update=update))


bag_app = command_group(
    'Inspect, check, repair and export bags. Exit codes: 0 the bag is '
    'whole, 2 bad input, or nothing in the bag can be read, 3 something in it is lost or wrong, 4 '
    'no disk space for the output.',
)


@bag_app.command()
def info(bag: BagArgument, as_json: JsonOption = False) -> None:
    """Show the contents of a bag: run, scene, outcome, robustness, topics."""
    from taxinet_ros.cli.bag.info import show_info

    raise typer.Exit(show_info(bag, as_json=as_json))


@bag_app.command()
def doctor(bag: BagArgument, as_json: JsonOption = False) -> None:
    """Check a bag; report each problem, where it is and how to repair it.

    Checks checksums, counts, stamps, type hashes, the completeness of every step, and the
    verdict, with every figure in it, against the recorded truth.
    """
    from taxinet_ros.cli.bag.doctor import run_bag_doctor

    raise typer.Exit(run_bag_doctor(bag, as_json=as_json))


@bag_app.command()
def recover(
    bag: BagArgument,
    out: Annotated[
        Path, typer.Option(metavar='NEW', help='folder for the new bag; must not exist')
    ],
) -> None:
    """Copy all messages up to the first damage, or to the end of an unfinished bag, to a new one.

    The original bag is never modified. mcap recover, a tool of MCAP, also looks behind the damage.
    """
    from taxinet_ros.cli.bag.repair import run_recover

    raise typer.Exit(run_recover(bag, out))


@bag_app.command()
def export(
    bag: BagArgument,
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE|DIR', writable=True,
            help='a new .csv, .parquet, .mp4 or .gif, or a folder for a table per topic',
        ),
    ],
    topics: Annotated[
        list[str] | None,
        typer.Option(
            metavar='TOPIC',
            help='topic to export (taxi_command, …); repeatable (default: all except frames)',
        ),
    ] = None,
    file_format: Annotated[
        str | None,
        typer.Option('--format', metavar='FORMAT', help='csv, parquet, mp4 or gif'),
    ] = None,
    run_id: RunOption = None,
) -> None:
    """Export topics as tables, or the run as a film.

    A table has one row per message; nested fields become dotted column names. Without --topics, a
    single file holds the run's trace, one row per control step. The film shows the camera frames
    with error, estimate, steering and robustness interval.
    """
    from taxinet_ros.cli.bag.export import run_export

    raise typer.Exit(run_export(bag, out, topics=topics or (), file_format=file_format, run=run_id))


@bag_app.command()
def split(
    bag: BagArgument,
    out: Annotated[
        Path, typer.Option(metavar='DIR', help='folder for the new bags; must be new or empty')
    ],
) -> None:
    """Split a recording into one bag per run, as recorded by the recorder node.

    For bags from ros2 bag record: several runs in one bag, logged by wall-clock time, with foreign
        topics. Each new bag is named after its run; the recording is never modified.
    """
    from taxinet_ros.cli.bag.repair import run_split

    raise typer.Exit(run_split(bag, out))


for command in (render, replay, compare, golden):
    bag_app.command()(command)
