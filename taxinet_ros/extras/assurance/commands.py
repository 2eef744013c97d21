"""``taxinet assure``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import JsonOption

assure_app = command_group(
    'Calibrate run-time monitors, and judge them in the loop (run them: --monitor).',
)


@assure_app.command('calibrate')
def assure_calibrate(
    program: Annotated[
        str, typer.Argument(metavar='SCENARIO', help='program whose scenes the perception is used '
        'to, such as that of its training')
    ],
    perception: Annotated[str, typer.Option(help='network: word or file')],
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE.npz', writable=True, dir_okay=False, help='calibration; must be new'
        ),
    ],
    runs: Annotated[
        int, typer.Option(min=1, max=100_000, help='runs that set the thresholds; a quarter as '
        'many more say what is usual')
    ] = 84,
    rate: Annotated[
        float, typer.Option(help='largest share of satisfied runs with an alarm, in these scenes, '
        'on average over calibrations')
    ] = 0.05,
    seed: Annotated[int, typer.Option(min=0, help='random seed of the scenes')] = 1,
    workers: Annotated[
        int, typer.Option(min=1, max=64, help='worker processes; same results')
    ] = 2,
) -> None:
    """Calibrate the shipped monitor for a network, on runs without ROS.

    Its four checks ask whether the picture is familiar, whether the estimates follow from each
    other, whether there is paint where they say that the line is, and whether they move as the
    picture is moved. Thresholds are conformal.
    """
    from rich.console import Console

    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.extras.assurance.calibrate import calibrate
    from taxinet_ros.extras.assurance.show import print_calibration

    with stage_bars(Console(stderr=True)) as show:
        found = calibrate(
            show, perception=perception, program=program, runs=runs, rate=rate, seed=seed,
            workers=workers, out=out,
        )
    print_calibration(found, out)


@assure_app.command('judge')
def assure_judge(
    program: Annotated[
        str, typer.Argument(metavar='SCENARIO', help='program whose scenes are driven')
    ],
    perception: Annotated[str, typer.Option(help='network: word or file')],
    monitor: Annotated[
        str, typer.Option(help='original, taxinet, a file of calibrate, or FILE.py:NAME')
    ],
    fallback: Annotated[
        list[str] | None,
        typer.Option(metavar='WHAT', help='stop, slow or second:PERCEPTION; repeatable'),
    ] = None,
    controller: Annotated[str, typer.Option(help='steering, a name, or FILE.py:NAME')] = 'steering',
    runs: Annotated[int, typer.Option(min=1, max=100_000, help='scenes')] = 100,
    seed: Annotated[int, typer.Option(min=0, help='random seed of the scenes')] = 0,
    workers: Annotated[
        int, typer.Option(min=1, max=64, help='worker processes; same results')
    ] = 2,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for runs and summary; the same command continues in it'),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge a monitor and its fallbacks in the loop: alarms, misses, lead times, and what it saves.

    Drives the same scenes without ROS: once with the monitor only watching, and once more for each
    fallback where it raised an alarm.
    """
    from taxinet_ros.core.user_code import short_word
    from taxinet_ros.extras.assurance.judge import JudgeOptions
    from taxinet_ros.extras.assurance.show import run_judge
    from taxinet_ros.trials.options import DEFAULT_ROOT, new_folder

    name = f'assure-{Path(program).stem}-{short_word(perception)}-seed{seed}'
    raise typer.Exit(run_judge(
        JudgeOptions(
            program=program, perception=perception, controller=controller, monitor=monitor,
            fallbacks=tuple(fallback or ('stop',)), runs=runs, seed=seed, workers=workers,
            out=out or new_folder(DEFAULT_ROOT / name),
        ),
        as_json=as_json,
    ))
