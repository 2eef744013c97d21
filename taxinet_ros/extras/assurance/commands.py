"""``taxinet assure``: calibrate run-time monitors, and say how they fare."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from matplotlib.figure import Figure
from rich.console import Console

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, write_png
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import JsonOption, ScenarioOption
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.cli.show import print_json
from taxinet_ros.core.assurance.monitor import SUSTAINED, monitor_doubts
from taxinet_ros.core.user_code import short_word
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.extras.assurance.calibrate import calibrate, check_share
from taxinet_ros.extras.assurance.judge import (
    ALARMS_NAME,
    BRAKING_S,
    REACH_S,
    RESULT_NAME,
    TRIALS_NAME,
    WANTED_RATIO,
    Judged,
    JudgeOptions,
    judge,
    plain_result,
)
from taxinet_ros.trials.options import DEFAULT_ROOT, new_folder, split_settings

TEXT = Path(__file__).with_name('show.j2')
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
    with stage_bars(Console(stderr=True)) as show:
        found = calibrate(
            show, perception=perception, program=program, runs=runs, rate=rate, seed=seed,
            workers=workers, out=out,
        )
    _print('calibrated', found=found, out=out, frames=SUSTAINED, most=check_share(found))


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
    settings: ScenarioOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for runs and summary; the same command continues in it'),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Judge a monitor and its fallbacks in the loop: alarms, misses, lead times, and what it saves.

    Drives the same scenes without ROS: once with the monitor only watching, and once more for each
    fallback where it raised an alarm.
    """
    overrides, gains = split_settings(settings or ())
    if gains:
        raise UsageError(f'--set steering.{min(gains)}: cannot be set together with --monitor')
    name = f'assure-{Path(program).stem}-{short_word(perception)}-seed{seed}'
    return run_judge(
        JudgeOptions(
            program=program, perception=perception, controller=controller, monitor=monitor,
            fallbacks=tuple(fallback or ('stop',)), runs=runs, seed=seed, workers=workers,
            out=out or new_folder(DEFAULT_ROOT / name), overrides=overrides,
        ),
        as_json=as_json,
    )


def run_judge(options: JudgeOptions, *, as_json: bool) -> int:
    """Judge a monitor and print how it fares.

    Returns:
        Exit code: 0, or 3 if scenes were left out, as runs of theirs could not be judged.

    Raises:
        UsageError: bad input.
    """
    for warning in monitor_doubts(options.monitor, options.perception):
        Console(stderr=True, emoji=False, highlight=False).print(
            warning, soft_wrap=True, markup=False)
    with stage_bars(Console(stderr=True)) as show:
        judged = judge(options, show)
    code = ExitCode.INCOMPLETE if judged.unjudged else ExitCode.OK
    if as_json:
        print_json(plain_result(options, judged))
        return code
    _print('judged', j=judged, reach_s=REACH_S, wanted=WANTED_RATIO)
    picture = write_png(trade_picture(judged), options.out, LIGHT)
    print(f'{options.out}: {TRIALS_NAME}, {ALARMS_NAME}, {picture.name}, {RESULT_NAME}')
    return code


def _print(macro: str, **values: Any) -> None:
    print(macro_text(TEXT, macro, **values))


def trade_picture(judged: Judged) -> Picture:
    """False alarms, and departures without an alarm in time, by multiple of the thresholds."""
    factors = [one.factor for one in judged.trade]
    false = [100 * one.false_share.rate for one in judged.trade]
    missed = [
        100 * (one.off - one.off_seen) / one.off if one.off else math.nan for one in judged.trade
    ]

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        axes.plot(
            factors, false, color=theme.passed, marker='o', label='satisfied runs: a false alarm'
        )
        axes.plot(
            factors, missed, color=theme.failed, marker='s',
            label=f'runs off the runway: no alarm {BRAKING_S:g} s before',
        )
        axes.axvline(1, color=theme.ink, linewidth=0.8, linestyle=':')
        axes.set_xscale('log', base=2)
        axes.set_xticks(factors[1::2], [f'{factor:g}' for factor in factors[1::2]])
        axes.set(xlabel='multiple of all thresholds (1: as calibrated)', ylabel='share [%]')
        axes.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=2)

    return Picture(
        name='trade', title='Thresholds', draw=draw,
        caption='What higher and lower thresholds would do, in the same runs.',
    )
