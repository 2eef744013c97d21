"""``taxinet assure``: calibrate run-time monitors, and say how they fare."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from taxinet_ros.analysis.report.parts import Picture, Theme
from taxinet_ros.analysis.report.pictures import LIGHT, write_png
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.cli.show import line_console, print_json
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
    Bounded,
    Judged,
    JudgeOptions,
    judge,
    plain_result,
)
from taxinet_ros.trials.rates import Rate

_PAGE_WIDTH = 100
_OCTAVES = 2
"""Multiples of the thresholds that the picture shows: 2 to the power of - this to + this."""


def print_calibration(found: Calibration, out: Path) -> None:
    """Print the thresholds of a calibration written to ``out``."""
    console = line_console(width=_PAGE_WIDTH)
    console.print(
        f'{out}: thresholds of {found.runs:,} satisfied runs of {found.program}, seed '
        f'{found.seed}; of further ones at most {100 * found.rate:g} % raise an alarm on average '
        f'over calibrations, in 95 % of which each check does in at most '
        f'{100 * check_share(found):.2g} %',
    )
    for name, threshold in found.thresholds.items():
        console.print(f'  {name}: above {threshold:.3g} for {SUSTAINED} frames')


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
    console = line_console(width=_PAGE_WIDTH)
    for trouble in judged.unjudged:
        console.print(f'left out, not judged: {trouble}')
    for line in judged_lines(judged):
        console.print(line)
    table = Table(box=None, pad_edge=False)
    table.add_column('fallback')
    for heading in ('satisfied', 'off the runway', 'rho 10, 50, 90 % [m]', 'fixed', 'broken'):
        table.add_column(heading, justify='right', no_wrap=True)
    table.add_row(
        'none', _share(judged.satisfied), _share(judged.off), _numbers(judged.rho_m), '', ''
    )
    for name, one in judged.with_fallback.items():
        table.add_row(
            name, _share(one.satisfied), _share(one.off), _numbers(one.rho_m),
            str(one.fixed), str(one.broken),
        )
    console.print(table, soft_wrap=False)
    for name, one in judged.with_fallback.items():
        console.print(f'{name}: {_ratio_words(one.off_ratio)}')
    picture = write_png(trade_picture(judged), options.out, LIGHT)
    console.print(
        f'{options.out}: {TRIALS_NAME}, {ALARMS_NAME}, {picture.name}, {RESULT_NAME}',
    )
    return code


def judged_lines(judged: Judged) -> list[str]:
    """Lines on the alarms of a monitor."""
    passed, per_h = judged.runs - judged.failed, judged.false_per_h
    reached, (in_time, late, missed) = judged.failed - judged.unreached, judged.left
    reasons = ', '.join(f'{name} {count}' for name, count in judged.reasons.items()) or 'none'
    return [
        f'{judged.runs:,} scenes; first alarms by check: {reasons}',
        f'of {judged.failed:,} failed runs {judged.in_time:,} have an alarm in time, '
        f'{judged.late:,} later, {judged.missed:,} none',
        f'{reached:,} of them left the 1.5 m: {in_time:,} with an alarm in time, {late:,} later, '
        f'{missed:,} without; seconds from the alarm to leaving them: {_spread(judged.lead_s)}',
        f'{judged.unreached:,} of them were not within the 1.5 m in the first {REACH_S:g} s; '
        f'seconds from the start to the alarm: {_spread(judged.unreached_alarm_s)}',
        f'of {judged.off.rate * judged.runs:.0f} runs that leave the runway {judged.off_missed:,} '
        f'have no alarm before; seconds from the alarm to leaving it: '
        f'{_spread(judged.off_lead_s)}',
        f'of {passed:,} satisfied runs {judged.false_alarms:,} have an alarm: '
        f'{_share(judged.false_share)}; {judged.settled_alarms:,} after the first {REACH_S:g} s: '
        f'{per_h.value:.3g} per hour from then on (95 %: {per_h.low:.3g} to {per_h.high:.3g})',
    ]


def trade_picture(judged: Judged) -> Picture:
    """Departures without an alarm in time against false alarms, by multiple of the thresholds."""
    shown = [one for one in judged.trade if abs(math.log2(one.factor)) <= _OCTAVES]
    false = np.array([100 * one.false_share.rate for one in shown])
    missed = np.array([one.off - one.off_seen for one in shown])

    def draw(figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        axes.plot(false, missed, color=theme.passed, marker='o', markersize=4, linewidth=1.4)
        factors: dict[tuple[float, int], list[float]] = {}
        for one, x, y in zip(shown, false, missed, strict=True):
            factors.setdefault((float(x), int(y)), []).append(one.factor)
        for place, there in factors.items():
            own = 1 in there
            axes.annotate(
                ', '.join(f'{factor:.2g}' for factor in there), place, xytext=(4, 4),
                textcoords='offset points', fontsize=10 if own else 8,
                color=theme.failed if own else theme.ink,
            )
            if own:
                axes.plot(*place, color=theme.failed, marker='o', markersize=7)
        axes.margins(0.1)
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.set_xlabel('satisfied runs with a false alarm [%]')
        axes.set_ylabel(
            f'of {shown[0].off} departures, without\nan alarm {BRAKING_S:g} s before'
        )

    return Picture(
        name='trade', title='Thresholds', draw=draw,
        caption='Runs that leave the runway without an alarm in time to brake, against false '
        'alarms; labels are multiples of all thresholds.',
    )


def _ratio_words(ratio: Bounded) -> str:
    if math.isnan(ratio.value):
        return 'no run leaves the runway, with it or without'
    rarer = 'no run leaves the runway, where some do without' if math.isinf(ratio.value) else (
        f'runs leave the runway {ratio.value:.3g} times less often')
    high = '' if math.isinf(ratio.high) else f' and at most {ratio.high:.3g}'
    holds = 'proven' if ratio.low >= WANTED_RATIO else 'not proven by these scenes'
    return (
        f'{rarer}; that it is at least {WANTED_RATIO:g} times rarer is {holds} (with 95 % '
        f'confidence, at least {ratio.low:.3g}{high} times)'
    )


def _share(share: Rate) -> str:
    return f'{100 * share.rate:.1f} % ({100 * share.low:.1f}-{100 * share.high:.1f})'


def _spread(quantiles: tuple[float, ...]) -> str:
    """The 10, 50 and 90 % quantiles of a time; infinite where no alarm came."""
    low, middle, high = _numbers(quantiles).split(', ')
    return f'{middle} in the median, {low} to {high} in the middle 80 %'


def _numbers(values: tuple[float, ...]) -> str:
    return ', '.join(
        '-' if math.isnan(x) else 'no alarm' if math.isinf(x) else f'{x:.2f}' for x in values
    )
