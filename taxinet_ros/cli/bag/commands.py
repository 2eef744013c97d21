"""``taxinet bag``: look into the bags of runs, check, mend, compare, replay and export them.

Exit codes: 0 the bag is whole, 2 bad input, or nothing in the bag can be
read, 3 something of it is lost or wrong, 4 no room for what was to be written.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.bag.limits import read_within_limits
from taxinet_ros.cli.options import OwnControllerOption, RunOption

BagArgument = Annotated[
    Path, typer.Argument(metavar='BAG', help='folder of a run, or an .mcap file')
]


def render(
    bag: BagArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar='NEW', help='folder for a new bag; without it, BAG itself gets them'),
    ] = None,
    run_id: RunOption = None,
) -> None:
    """Add the camera frames to a bag that was recorded without them.

    Bit for bit those of the run: the recorded commands drive the aircraft again, and the recorded
    odometry proves that it went the same way. Under the same name the new bag has the very bytes
    of one recorded with --images all.
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
            help="another one than the run's: a word, a weights file, an .onnx network or "
            'FILE.py:NAME'
        ),
    ] = None,
    controller: OwnControllerOption = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='new folder for picture and table, else below bags/'),
    ] = None,
    tolerance_cte: Annotated[
        float,
        typer.Option(
            metavar='M', help='how far cross-track estimates may be off; 0: every bit counts'
        ),
    ] = 0.0,
    tolerance_he: Annotated[
        float,
        typer.Option(
            metavar='DEG', help='how far heading estimates may be off; 0: every bit counts'
        ),
    ] = 0.0,
) -> None:
    """Feed a recorded run to one node; compare its answers with those recorded.

    The regression test for a retrained network. Frames that the bag lacks are rendered. Exit code:
    0 equal within the tolerances, 1 different, 2 bad input, 4 the node broke.
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
        float, typer.Option(help='how far floating-point numbers may be apart; 0: every bit counts')
    ] = 0.0,
    skip: Annotated[
        list[str] | None,
        typer.Option(metavar='TOPIC', help='leave out (camera/image_raw, …); repeatable'),
    ] = None,
    run_id: RunOption = None,
    other_run: Annotated[
        str | None,
        typer.Option(metavar='RUN_ID', help='which run of OTHER, where that holds several'),
    ] = None,
) -> None:
    """Find where two bags begin to differ: topic, step and field.

    Names of runs are not compared. Exit code: 0 the same, 1 different, 2 bad input.
    """
    from taxinet_ros.bag.limits import read_within_limits
    from taxinet_ros.cli.bag.compare import run_compare
    from taxinet_ros.cli.bag.input import one_run, readable_bags

    with (
        readable_bags(), read_within_limits(bag, other), one_run(bag, run_id) as one,
        one_run(other, other_run) as two,
    ):
        code = run_compare(one.path, two.path, tolerance=tolerance, skip=skip or ())
    raise typer.Exit(code)


def golden(
    folder: Annotated[
        Path, typer.Argument(metavar='[DIR]', help='folder of bags', show_default=True)
    ] = Path('bags/golden'),
    update: Annotated[
        bool, typer.Option('--update', help='show the differences, then record anew what differs')
    ] = False,
) -> None:
    """Run the golden bags' scenes again and compare, to see what a change has changed.

    Where processor or libraries are others than those that the bags come from, numbers may be a
    little apart. Exit code: 0 the same, 1 different, with --update 0 also then.
    """
    from taxinet_ros.cli.bag.rerun import run_golden

    raise typer.Exit(run_golden(folder, update=update))


bag_app = typer.Typer(
    rich_markup_mode=None,
    help='Inspect, check, repair and export bags. Exit codes: 0 the bag is '
    'whole, 2 bad input, or nothing in the bag can be read, 3 something of it is lost or wrong, '
    '4 no room for what was to be written.',
)
RecordedBagArgument = Annotated[
    Path, typer.Argument(metavar='BAG', help='folder of a run, or an .mcap file')
]
JsonOption = Annotated[bool, typer.Option('--json', help='print one JSON object instead')]


@bag_app.callback(invoke_without_command=True)
def _bag(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


@bag_app.command()
def info(bag: RecordedBagArgument, as_json: JsonOption = False) -> None:
    """Show what is in a bag: run, scene, outcome, robustness, topics."""
    from taxinet_ros.cli.bag.info import show_info

    with read_within_limits(bag):
        raise typer.Exit(show_info(bag, as_json=as_json))


@bag_app.command()
def doctor(
    bag: RecordedBagArgument,
    as_json: JsonOption = False,
    images: Annotated[
        bool,
        typer.Option('--images', help='also render every camera frame once more and compare'),
    ] = False,
    run_id: RunOption = None,
) -> None:
    """Check everything about a bag; say what is wrong, where, and what mends it.

    Checksums, indexes, counts, stamps, type hashes, completeness of every step, and whether the
    verdict follows from the recorded truth.
    """
    from taxinet_ros.cli.bag.doctor import run_bag_doctor

    with contextlib.nullcontext() if images else read_within_limits(bag):
        raise typer.Exit(run_bag_doctor(bag, as_json=as_json, images=images, run=run_id))


@bag_app.command()
def recover(
    bag: RecordedBagArgument,
    out: Annotated[
        Path, typer.Option(metavar='NEW', help='folder for the new bag, which must not exist')
    ],
) -> None:
    """Write all sound messages of a damaged or unfinished bag into a new one.

    The bag itself is never touched.
    """
    from taxinet_ros.cli.bag.repair import run_recover

    with read_within_limits(bag):
        raise typer.Exit(run_recover(bag, out))


@bag_app.command()
def export(
    bag: RecordedBagArgument,
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE|DIR',
            help='a new .csv, .parquet, .mp4 or .gif, or a folder for a table per topic',
        ),
    ],
    topics: Annotated[
        list[str] | None,
        typer.Option(
            metavar='TOPIC',
            help='topic to make a table of (taxi_command, …); repeatable, default all but frames',
        ),
    ] = None,
    file_format: Annotated[
        str | None,
        typer.Option('--format', metavar='FORMAT', help='csv, parquet, mp4 or gif'),
    ] = None,
    run_id: RunOption = None,
) -> None:
    """Make tables of topics, or a film of the run.

    A table has a row per message, nested fields as columns with dots. Without --topics a single
    file gets the run's trace, a row per control step. The film shows the camera's frames with the
    error, the estimate, the steering and the robustness interval.
    """
    from taxinet_ros.cli.bag.export import run_export

    film = {file_format, out.suffix[1:]} & {'mp4', 'gif'}
    with contextlib.nullcontext() if film else read_within_limits(bag):
        raise typer.Exit(run_export(
            bag, out, topics=topics or (), file_format=file_format, run=run_id
        ))


@bag_app.command()
def split(
    bag: RecordedBagArgument,
    out: Annotated[
        Path, typer.Option(metavar='DIR', help='folder for the new bags; must be new or empty')
    ],
) -> None:
    """Make a bag of each run that a recording holds, as our own recorder would have.

    For what ros2 bag record made: several runs in one bag, logged by the wall clock, with topics of
    others. Each new bag is named as its run; the recording itself is never touched.
    """
    from taxinet_ros.cli.bag.repair import run_split

    with read_within_limits(bag):
        raise typer.Exit(run_split(bag, out))

for command in (render, replay, compare, golden):
    bag_app.command()(command)
