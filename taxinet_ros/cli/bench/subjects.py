"""``taxinet bench``: table of timings on this machine."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from taxinet_ros.bench.report import (
    Report,
    bounds_text,
    compare_reports,
    load_report,
    ratio_violations,
)
from taxinet_ros.bench.run import ALL, GRAPH, run_subjects
from taxinet_ros.bench.subjects.closed_loop import WHOLE
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.errors import ExitCode, UsageError

_WIDTH = 100
"""Width of the table [columns] when written to a file."""


def run_bench(
    words: Sequence[str],
    *,
    repeats: int,
    as_json: bool,
    old: Path | None,
    peers: str | None = None,
    guard: bool = False,
) -> int:
    """Measure and print, with an older report and third-party monitors for comparison if given.

    Returns:
        Exit code: 1 with ``guard`` if a guarded ratio is out of bounds, else 0.

    Raises:
        UsageError: an unknown subject, bad repeats, a missing report, no peers, or nothing to
        guard.
        InfraError: a run has no verdict.
    """
    if guard and not ({GRAPH, ALL} & set(words or [ALL])):
        raise UsageError(f'bench: --guard checks the ratios of the graph; name {GRAPH} or {ALL}')
    before = None if old is None else load_report(old)
    with stage_bars(Console(stderr=as_json)) as show:
        report = run_subjects(
            words, repeats, lambda done, total: show('measuring', done, total), peers
        )
    if before is not None:
        report['compared'] = {'with': str(old), **compare_reports(report, before)}
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        _print(report)
    troubles = ratio_violations(report.get('ratios', {})) if guard else []
    if guard and not any(bounds_text(ratio) for ratio in report.get('ratios', {}).values()):
        raise UsageError('bench: --guard: no guarded ratio was measured; the graph needs ROS 2')
    for line in troubles:
        print(line, file=sys.stderr)
    return ExitCode.VIOLATED if troubles else ExitCode.OK


def _print(report: Report) -> None:
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    console.print(_line(report['machine']), soft_wrap=True, markup=False)
    compared = report.get('compared')
    table = Table(box=None, pad_edge=False)
    table.add_column('', no_wrap=True)
    for heading in ('median', 'spread', 'least', 'cpu', 'runs', 'real time', 'per core'):
        table.add_column(heading, justify='right', no_wrap=True)
    if compared:
        table.add_column('new/old', justify='right', no_wrap=True)
    for name, figure in report['figures'].items():
        cells = _cells(figure)
        if compared:
            ratio = compared['ratios'].get(name)
            cells.append('-' if ratio is None else f'{ratio:.2f}')
        part = name.split('/', 2)[2:]
        table.add_row(f'  {part[0]}' if part else name, *cells)
    console.print(table)
    console.print('spread: interquartile range, as a share of the median', style='dim')
    if any(figure['real_time_factor'] for figure in report['figures'].values()):
        line = 'real time: simulated time per wall-clock time, and per processor time'
        console.print(line, style='dim')
    _print_sections(console, report)
    if compared:
        console.print(f'new/old: ratio of medians, old: {compared["with"]}', soft_wrap=True)
        for fact, (was, now) in compared['differences'].items():
            console.print(f'not the same machine: {fact} was {was}, is {now}', soft_wrap=True)


def _print_sections(console: Console, report: Report) -> None:
    """Print derived figures: parts of a control step, ratios, amounts."""
    if tick := report.get('tick'):
        rows = [
            [part, _time(time_s), f'{time_s / tick[WHOLE]:.0%}'] for part, time_s in tick.items()
        ]
        _print_table(console, ('a control step of the composed graph', 'cpu', 'share'), rows)
    if ratios := report.get('ratios'):
        rows = [
            [name, f'{ratio["value"]:.2f}', f'{ratio["low"]:.2f} .. {ratio["high"]:.2f}',
             ratio['clock'], bounds_text(ratio)]
            for name, ratio in ratios.items()
        ]  # fmt: skip
        _print_table(console, ('ratio', 'value', 'quartiles', 'clock', 'guarded'), rows)
    if amounts := report.get('amounts'):
        rows = [[name, f'{size / 1e6:.1f} MB'] for name, size in amounts.items()]
        _print_table(console, ('amount', ''), rows)
    for word, reason in report.get('left_out', {}).items():
        console.print(f'left out: {word}: {reason}')


def _print_table(
    console: Console, headings: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    console.print()
    table = Table(box=None, pad_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(heading, justify='right' if number else 'left', no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console.print(table)


def _line(facts: Mapping[str, Any]) -> str:
    return ', '.join(f'{name.replace("_", " ")} {value}' for name, value in facts.items())


def _cells(figure: Mapping[str, Any]) -> list[str]:
    median = figure['median_s']
    factors = (figure['real_time_factor'], figure['real_time_per_core'])
    return [
        _time(median),
        f'{(figure["q3_s"] - figure["q1_s"]) / median:.0%}' if median > 0 else '',
        _time(figure['min_s']),
        '' if figure['cpu_s'] is None else _time(figure['cpu_s']),
        str(figure['repeats']),
        *('' if factor is None else f'{factor:.3g}x' for factor in factors),
    ]


def _time(seconds: float) -> str:
    """Format a time with three digits and its unit."""
    for unit, size in (('s', 1.0), ('ms', 1e-3)):
        if seconds >= size:
            value = seconds / size
            return f'{value:.0f} {unit}' if value >= 100 else f'{value:.3g} {unit}'
    return f'{seconds * 1e6:.3g} us'
