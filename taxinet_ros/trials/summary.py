"""Printed lines of a campaign: heading, one line per run, and summary."""

from __future__ import annotations

import math
import shlex
import statistics
from collections.abc import Sequence
from typing import Any

from rich.text import Text

from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl.specs import MOST_UNUSABLE_SHARE
from taxinet_ros.core.pacing.free_run import free_run_line
from taxinet_ros.core.place.catalogue import DEFAULT_PLACE
from taxinet_ros.core.place.track import RUNWAY_TRACK
from taxinet_ros.core.rig.catalogue import DEFAULT_AIRCRAFT, DEFAULT_CAMERA
from taxinet_ros.core.scenario_fields import along_words, clock_words, unusual_words
from taxinet_ros.core.verdict.judge import SpecCheck
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.plain_values import plain
from taxinet_ros.registry import KMWH
from taxinet_ros.trials.options import LOOP, CampaignOptions
from taxinet_ros.trials.rates import Planned, ProgramRate, count_outcomes, failure_rate
from taxinet_ros.trials.record.row import RunRow

_MOST_NAMED = 5
"""Maximum number of runs named in one line."""
_USUAL = ('', DEFAULT_PLACE, DEFAULT_AIRCRAFT, DEFAULT_CAMERA)

ON_STANDING_GRAPH = 'on the graph that runs'
"""Text for nodes that were started externally."""

_STYLES = {
    Outcome.PASS: 'green',
    Outcome.FAIL: 'red',
    Outcome.REJECTED: 'yellow',
    Outcome.INFRA_ERROR: 'bold magenta',
    Outcome.INTERRUPTED: 'yellow',
}


def campaign_heading(options: CampaignOptions) -> str:
    """Heading that describes the campaign."""
    runs = 'run' if options.runs == 1 else 'runs'
    layout = 'separate processes' if options.processes else 'one process'
    layout = layout if options.workers == 1 else workers_words(options)
    graph = f'{participants_words(options)}, {layout}'
    return (
        f'{options.runs} {runs} of {options.program}, seed {options.seed}, '
        f'{ON_STANDING_GRAPH if options.standing_graph else graph} -> {options.out}'
    )


def workers_words(options: CampaignOptions) -> str:
    """What makes the runs: workers here, or a cluster."""
    if options.cluster:
        return f'cluster {options.cluster}'
    return '1 worker' if options.workers == 1 else f'{options.workers} workers'


def participants_words(options: CampaignOptions) -> str:
    """Perception, controller and world as text; defaults are omitted."""
    steers = '' if options.controller == STEERING else f', controller {options.controller}'
    there = '' if options.world == KMWH else f', world {options.world}'
    late = f', {options.timing.words}' if options.timing.words else ''
    loop = f', {engine_words(options)}' if options.engine == LOOP else ''
    return f'perception {options.perception}{steers}{there}{late}{loop}'


def engine_words(options: CampaignOptions) -> str:
    """The engine, and which share of its runs is audited on the graph."""
    return f'engine {options.engine}, {options.audit_percent:g} % audited'


def requirement_lines(check: SpecCheck, *, quiet: bool = False) -> list[Text]:
    """Lines on how the requirements are interpreted, with warnings of likely mistakes."""
    lines = [] if quiet else [Text(line, style='dim') for line in check.lines]
    return [*lines, *(Text(f'warning: {line}', style='yellow') for line in check.warnings)]


def row_line(row: RunRow) -> Text:
    """One run: outcome, robustness, worst deviation, speed, scene."""
    text = Text(f'{row.index:5d}  ')
    text.append(f'{row.outcome:<5}', style=_STYLES[row.outcome])
    if row.outcome.judged:
        text.append(f' {rho_words(row, 7)}  |CTE| <= {row.max_cross_track_m:4.1f} m  ')
        text.append('off runway  ' if row.left_runway else ' ' * 12, style='red')
        text.append(f'{row.real_time_factor:5.1f}x  ')
        if row.stopped_early:
            text.append(f'stopped at {row.stopped_s:.1f} s  ')
        if row.unusable_share > MOST_UNUSABLE_SHARE:
            text.append(
                f'{row.unusable_estimates} of {row.steps} estimates unusable  ', style='yellow'
            )
        text.append(f'{free_run_line(row.free)}  ' if row.free else '')
    else:
        words = [word for word in (row.kind, row.who) if word]
        text.append(f' {" ".join(words)}: ' if words else ' ')
        text.append(f'{row.detail}  ')
    text.append(scene_words(row), style='dim')
    return text


def rho_words(row: RunRow, width: int = 0) -> str:
    """The headline's robustness, or its bounds if the run was stopped early."""
    assert row.headline is not None
    return row.headline.bound_words(width)


def scene_words(row: RunRow) -> str:
    """Short description of a scene in human units; empty if none was drawn."""
    if row.time_of_day_h is None or row.rain_percent is None:
        return ''
    rain = f' rain {_percent(row.rain_percent)} %' if row.rain_percent > 0 else ''
    words = row.place, row.aircraft, row.camera
    where = ''.join(f'  {word}' for word in words if word not in _USUAL)
    track = '' if row.track in ('', RUNWAY_TRACK) else f' {along_words(row.track)}'
    return (
        f'CTE {row.cross_track_m:+.1f} m  HE {row.heading_deg:+.0f} deg  '
        f'at {row.distance_m:.0f} m{track}  {clock_words(row.time_of_day_h)} {row.clouds}{rain}'
        f'{unusual_words(row.scene)}{where}'
    )


def _percent(value: float) -> str:
    """A percentage without decimals; positive values are never shown as 0."""
    return f'{value:.0f}' if value >= 1 else f'{value:.1g}'


def table_line(rows: Sequence[RunRow], options: CampaignOptions) -> str:
    """Line with the paths of table and bags."""
    folders = {(options.out / row.bag).parent for row in rows if row.bag}
    if not options.standing_graph:
        folders = {options.out}
    bags = ', '.join(f'{folder}/<run>/' for folder in sorted(folders))
    bags = bags or "where the graph's recorder writes them"
    return f'table: {options.out / "runs.csv"}, runs.parquet; bags: {bags}'


def campaign_summary(rows: Sequence[RunRow], options: CampaignOptions) -> str:
    """Summary: counts, rate with its interval, speed, and path of the table."""
    lines = [count_outcomes(rows)]
    speeds = [row.real_time_factor for row in rows if row.outcome.judged]
    if speeds:
        found = failure_rate(rows, options.runs)
        speed = statistics.median(speeds)
        lines.append(
            f'{_satisfied_words(found)}, {off_runway_words(rows)}, median {speed:.1f}x real time'
        )
        lines += [*stopped_words(rows), *blind_words(rows)]
    lines += free_words(rows)
    lines += refused_words(rows)
    lines += [table_line(rows, options), *next_line(rows, options)]
    return '\n'.join(line for line in lines if line)


def next_line(rows: Sequence[RunRow], options: CampaignOptions) -> list[str]:
    """Line with the command that is useful next: for failures the one that explains them."""
    out = shlex.quote(str(options.out))
    if options.standing_graph or not any(row.outcome.judged for row in rows):
        return []
    if any(row.outcome is Outcome.FAIL for row in rows):
        return [f'next: taxinet why {out}']
    return [f'next: taxinet gate {out} --min-satisfaction 0.95']


def summary_json(
    rows: Sequence[RunRow], options: CampaignOptions, planned: Planned
) -> dict[str, Any]:
    """The summary as plain values for JSON.

    Args:
        rows: the runs.
        options: of the campaign.
        planned: see :func:`~taxinet_ros.trials.rates.failure_rate`.
    """
    found = failure_rate(rows, planned)
    least = [(row.headline.upper, row.headline.lower, row.run_id, row.outcome.value)
             for row in rows if row.headline is not None and row.outcome.judged]
    rate, worst = None, None
    if least:
        upper, lower, run_id, outcome = min(least)
        worst = {'run_id': run_id, 'outcome': outcome, 'rho': [lower, upper]}
    if found.rate is not None:
        value, low, high = found.rate.other
        rate = {
            'value': value, 'low': low, 'high': high, 'confidence': 0.95,
            'anytime': found.anytime,
        }
    return plain({
        'program': options.program, 'seed': options.seed, 'perception': options.perception,
        'controller': options.controller, 'runs': len(rows),
        'outcomes': {
            outcome.value: number for outcome in Outcome
            if (number := sum(row.outcome is outcome for row in rows))
        },
        'off_runway': sum(bool(row.left_runway) for row in rows),
        'satisfied': rate, 'why_no_rate': found.why_not or None,
        'worst': worst, 'out': options.out,
    })


def _satisfied_words(failed: ProgramRate) -> str:
    if failed.rate is None:
        return failed.why_not
    value, low, high = failed.rate.other
    when = ' that holds wherever a campaign stops' if failed.anytime else ''
    return f'satisfied {value:.0%} (95 % interval{when} {low:.0%}-{high:.0%})'


def blind_words(rows: Sequence[RunRow]) -> list[str]:
    """Line on the runs that passed although the perception was blind, if any."""
    blind = [row.index for row in rows if row.passed_blind]
    if not blind:
        return []
    named = ', '.join(map(str, blind[:_MOST_NAMED])) + (', …' if len(blind) > _MOST_NAMED else '')
    return [
        f'warning: {len(blind)} passed with more than {MOST_UNUSABLE_SHARE:.0%} of their frames '
        f'without a usable estimate (run {named}); --spec usable fails them'
    ]


def refused_words(rows: Sequence[RunRow]) -> list[str]:
    """Lines on draws rejected by the requirements, and on impossible scenes."""
    rejected = [row for row in rows if row.outcome is Outcome.REJECTED]
    refused = sum(row.refused for row in rows)
    lines = []
    if refused:
        lines.append(f'{refused} draws refused by the requirements and replaced')
    if rejected:
        lines.append(
            f'{len(rejected)} of {len(rows)} scenes rejected; shares are among the judged runs; '
            f'the first: {rejected[0].detail}'
        )
    return lines


def free_words(rows: Sequence[RunRow]) -> list[str]:
    """Line on free runs, if any."""
    free = [row.free for row in rows if row.free and 'loop_wall_median_s' in row.free]
    if not free:
        return []
    frames, unanswered, overruns = (
        sum(one[name] for one in free) for name in ('frames', 'unanswered', 'overruns')
    )
    late = f'; {overruns:.0f} frames out late: not the pace asked for' if overruns else ''
    return [
        f'free runs, which need not come out so again: {unanswered:.0f} of {frames:.0f} frames '
        f'unanswered, loop {statistics.median(one["loop_wall_median_s"] for one in free):.3f} s by '
        f'the clock, at most {max(one["loop_wall_max_s"] for one in free):.3f} s, '
        f'{statistics.median(one.get("factor", math.nan) for one in free):.2f}x real time{late}'
    ]


def off_runway_words(rows: Sequence[RunRow]) -> str:
    """Number of runs that left the runway; unknown for runs stopped before."""
    off = sum(bool(row.left_runway) for row in rows)
    stopped = any(row.stopped_early and not row.left_runway for row in rows)
    return f'{off} off the runway{" before they were stopped" if stopped else ""}'


def stopped_words(rows: Sequence[RunRow]) -> list[str]:
    """Line on the runs stopped early and the time saved, if any."""
    stopped = [row for row in rows if row.stopped_early]
    if not stopped:
        return []
    whole_s = sum(row.duration_s or 0.0 for row in rows if row.outcome.judged)
    saved_s = sum((row.duration_s or 0.0) - row.sim_s for row in stopped)
    return [
        f'{len(stopped)} stopped early, which saved {saved_s:.0f} of {whole_s:.0f} s of simulated '
        f'time ({saved_s / whole_s:.0%})'
    ]
