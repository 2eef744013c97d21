"""The lines that a campaign prints: what is run, one line per run, what came of it."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from rich.text import Text

from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.rates import summarise
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.outcome import Outcome

_STYLES = {
    Outcome.PASS: 'green',
    Outcome.FAIL: 'red',
    Outcome.REJECTED: 'yellow',
    Outcome.INFRA_ERROR: 'bold magenta',
    Outcome.INTERRUPTED: 'yellow',
}


def heading(options: CampaignOptions) -> str:
    """What is about to run."""
    runs = 'run' if options.runs == 1 else 'runs'
    layout = 'separate processes' if options.processes else 'one process'
    return (
        f'{options.runs} {runs} of {options.program}, seed {options.seed}, perception '
        f'{options.perception}, {layout} -> {options.out}'
    )


def row_line(row: RunRow) -> Text:
    """One run: outcome, robustness, worst deviation, speed, scene."""
    text = Text(f'{row.index:5d}  ')
    text.append(f'{row.outcome:<5}', style=_STYLES[row.outcome])
    if row.outcome.judged:
        headline = next(iter(row.rho.values()))
        text.append(f' rho {headline:+7.2f}  |CTE| <= {row.max_cross_track_m:4.1f} m  ')
        text.append('off runway  ' if row.left_runway else ' ' * 12, style='red')
        text.append(f'{row.real_time_factor:5.1f}x  ')
    else:
        words = [word for word in (row.kind, row.who) if word]
        text.append(f' {" ".join(words)}: ' if words else ' ')
        text.append(f'{row.detail}  ')
    text.append(scene_words(row), style='dim')
    return text


def scene_words(row: RunRow) -> str:
    """A scene in a few words, in the units people read; empty where none was drawn."""
    if row.time_of_day is None or row.rain is None:
        return ''
    hours, minutes = divmod(round(row.time_of_day * 60), 60)
    rain = f' rain {row.rain:.0f} %' if row.rain > 0 else ''
    return (
        f'CTE {row.cross_track:+.1f} m  HE {row.heading:+.0f} deg  at {row.distance:.0f} m  '
        f'{hours:02d}:{minutes:02d} {row.clouds}{rain}'
    )


def summary(rows: Sequence[RunRow], options: CampaignOptions) -> str:
    """What came of it all: counts, rate with its interval, speed, and where the table is."""
    figures = summarise(rows)
    lines = [', '.join(f'{n} {outcome}' for outcome, n in figures.counts.items() if n)]
    if figures.judged:
        value, low, high = figures.satisfied
        off = sum(bool(row.left_runway) for row in rows)
        speed = statistics.median(row.real_time_factor for row in rows if row.outcome.judged)
        lines.append(
            f'satisfied {value:.0%} (95 % interval {low:.0%}-{high:.0%}), '
            f'{off} off the runway, median {speed:.1f}x real time'
        )
    lines.append(f'table: {options.out / "runs.csv"}, runs.parquet; bags: {options.out}/<run>/')
    return '\n'.join(line for line in lines if line)
