"""The commands about recorded runs and requirements: ``taxinet monitor``, ``taxinet spec``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.option_types import BoundOption, RateOption, RunOption


def monitor(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar='BAG...', help='folders of runs, .mcap files, or folders of campaigns'
        ),
    ],
    spec: Annotated[
        list[str] | None,
        typer.Option(
            '--spec', metavar='FORMULA',
            help='phi_eventually, phi_always, on_runway, usable, NAME=FORMULA, a formula, or a '
            'YAML file of them; repeatable; default: those that judged the run',
        ),
    ] = None,
    run_id: RunOption = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.png|DIR',
            help='draw signals, bounds and robustness over time; a folder for several bags',
        ),
    ] = None,
    bound: BoundOption = None,
    rate: RateOption = None,
    add: Annotated[
        bool, typer.Option('--add', help="add a column for each new formula to a campaign's table")
    ] = False,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
    workers: Annotated[int, typer.Option(min=1, help='processes that judge; same results')] = 2,
) -> None:
    """Judge recorded runs, by what judged them or by new requirements.

    Needs no ROS and no pictures. A bag of several runs, as ros2 bag record makes them, gets a
    verdict for each. A formula that judged a run gets the recorded robustness again,
    to the last bit. Exit codes: 0 all satisfied, 1 some violated, 2 bad input, 3 some bag is
    incomplete or damaged, or contradicts what was recorded in it.
    """
    from taxinet_ros.cli.monitor import run_monitor

    raise typer.Exit(
        run_monitor(
            bags, specs=spec or (), plot=plot, add=add, as_json=as_json, workers=workers,
            bounds=bound or (), rates=rate or (), run=run_id,
        )
    )


def spec(
    formulas: Annotated[
        list[str],
        typer.Argument(
            metavar='FORMULA...',
            help='phi_eventually, usable, NAME=FORMULA, a formula, or a YAML file of them',
        ),
    ],
    duration: Annotated[float, typer.Option(help='length of the runs that it will judge [s]')] = 30,
    settings: Annotated[
        list[str] | None,
        typer.Option('--set', metavar='steering.GAIN=VALUE', help='a gain of the controller'),
    ] = None,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
) -> None:
    """Say how requirements are understood, and warn of what they may not say.

    Nothing is run. Exit codes: 0 they can be judged, whatever is warned of; 2 they cannot.
    """
    from taxinet_ros.cli.spec import show_specs

    show_specs(formulas, duration_s=duration, settings=settings or (), as_json=as_json)
