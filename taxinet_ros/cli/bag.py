"""``taxinet bag``: look into the bags of runs, check, mend and export them.

Exit codes: 0 the bag is whole, 3 something of it is lost or wrong, 1 nothing in it can be read,
2 bad input, 4 no room for what was to be written.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.bag.limits import read_within_limits
from taxinet_ros.cli.bag_rerun_commands import compare, golden, render, replay
from taxinet_ros.cli.option_types import RunOption

bag_app = typer.Typer(
    rich_markup_mode=None,
    help='Look into the bags of runs, check, mend and export them. Exit codes: 0 the bag is '
    'whole, 3 something of it is lost or wrong, 1 nothing in it can be read, 2 bad input, '
    '4 no room for what was to be written.',
)

BagArgument = Annotated[
    Path, typer.Argument(metavar='BAG', help='folder of a run, or an .mcap file')
]
JsonOption = Annotated[bool, typer.Option('--json', help='print one JSON object instead')]


@bag_app.callback(invoke_without_command=True)
def _bag(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


@bag_app.command()
def info(bag: BagArgument, as_json: JsonOption = False) -> None:
    """Tell what is in a bag: run, scene, outcome, robustness, topics."""
    from taxinet_ros.cli.bag_info import show_info

    with read_within_limits(bag):
        raise typer.Exit(show_info(bag, as_json=as_json))


@bag_app.command()
def doctor(
    bag: BagArgument,
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
    from taxinet_ros.cli.bag_doctor import run_doctor

    with contextlib.nullcontext() if images else read_within_limits(bag):
        raise typer.Exit(run_doctor(bag, as_json=as_json, images=images, run=run_id))


@bag_app.command()
def recover(
    bag: BagArgument,
    out: Annotated[
        Path, typer.Option(metavar='NEW', help='folder for the new bag, which must not exist')
    ],
) -> None:
    """Write all that is sound of a damaged or unfinished bag into a new one.

    The bag itself is never touched.
    """
    from taxinet_ros.cli.bag_recover import run_recover

    with read_within_limits(bag):
        raise typer.Exit(run_recover(bag, out))


@bag_app.command()
def export(
    bag: BagArgument,
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
    from taxinet_ros.cli.bag_export import run_export

    film = {file_format, out.suffix[1:]} & {'mp4', 'gif'}
    with contextlib.nullcontext() if film else read_within_limits(bag):
        raise typer.Exit(run_export(
            bag, out, topics=topics or (), file_format=file_format, run=run_id
        ))


@bag_app.command()
def split(
    bag: BagArgument,
    out: Annotated[
        Path, typer.Option(metavar='DIR', help='folder for the new bags; must be new or empty')
    ],
) -> None:
    """Make a bag of each run that a recording holds, as our own recorder would have.

    For what ros2 bag record made: several runs in one bag, logged by the wall clock, with topics of
    others. Each new bag is named as its run; the recording itself is never touched.
    """
    from taxinet_ros.cli.bag_split import run_split

    with read_within_limits(bag):
        raise typer.Exit(run_split(bag, out))


for command in (render, replay, compare, golden):
    bag_app.command()(command)
