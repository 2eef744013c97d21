"""The commands of ``taxinet bag`` that run a recorded run again, in whole or in part."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.option_types import OwnControllerOption, RunOption

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
    """Put the camera frames into a bag that was recorded without them.

    Bit for bit those of the run: the recorded commands drive the aircraft again, and the recorded
    odometry proves that it went the same way. Under the same name the new bag has the very bytes
    of one recorded with --images all.
    """
    from taxinet_ros.cli.bag_render import run_render

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
    from taxinet_ros.cli.bag_input import readable_run
    from taxinet_ros.cli.bag_replay import ReplayOptions, run_replay

    with readable_run(bag, run_id) as whole:
        options = ReplayOptions(
            bag=whole, target=into, perception=perception, controller=controller, out=out,
            tolerance_cte_m=tolerance_cte, tolerance_he_deg=tolerance_he,
        )
        code = run_replay(options)
    raise typer.Exit(code)


def compare(
    bag: BagArgument,
    other: Annotated[Path, typer.Argument(metavar='OTHER', help='the bag to hold against it')],
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
    """Say where two bags begin to differ: topic, step and field.

    Names of runs are not compared. Exit code: 0 the same, 1 different, 2 bad input.
    """
    from taxinet_ros.bag.limits import read_within_limits
    from taxinet_ros.cli.bag_compare import run_compare
    from taxinet_ros.cli.bag_input import one_run, readable_bags

    with (
        readable_bags(), read_within_limits(bag, other), one_run(bag, run_id) as one,
        one_run(other, other_run) as two,
    ):
        code = run_compare(one, two, tolerance=tolerance, skip=skip or ())
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
    from taxinet_ros.cli.bag_golden import run_golden

    raise typer.Exit(run_golden(folder, update=update))
