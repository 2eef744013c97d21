"""``taxinet assure``: calibrate run-time monitors, and say how they fare."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, write_png
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.cli.show import print_json
from taxinet_ros.core.assurance.monitor import SUSTAINED, Calibration, monitor_doubts
from taxinet_ros.errors import ExitCode
from taxinet_ros.extras.assurance.calibrate import check_share
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

TEXT = Path(__file__).with_suffix('.j2')


def print_calibration(found: Calibration, out: Path) -> None:
    """Print the thresholds of a calibration written to ``out``."""
    _print('calibrated', found=found, out=out, frames=SUSTAINED, most=check_share(found))


def run_judge(options: JudgeOptions, *, as_json: bool) -> int:
    """Judge a monitor and print how it fares.

    Returns:
        Exit code: 0, or 3 if scenes were left out, as runs of theirs could not be judged.

    Raises:
        UsageError: bad input.
    """
    for warning in monitor_doubts(options.monitor, options.perception):
        Console(stderr=True).print(warning, soft_wrap=True, markup=False, highlight=False)
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
