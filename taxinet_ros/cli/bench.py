"""``taxinet bench``: a table of how long everything takes on this machine."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from taxinet_ros.bench.compare import Report, compare, load_report
from taxinet_ros.bench.run import run_subjects
from taxinet_ros.cli.progress import stage_bars

_WIDTH = 100
"""Columns of the table where it goes into a file."""


def run_bench(
    words: Sequence[str],
    *,
    repeats: int,
    as_json: bool,
    old: Path | None,
    peers: str | None = None,
) -> None:
    """Measure and print, beside an older report and other people's monitors where there are any.

    Raises:
        UsageError: an unknown subject, bad repeats, no report to compare with, or no peers.
    """
    before = None if old is None else load_report(old)
    with stage_bars(Console(stderr=as_json)) as show:
        report = run_subjects(
            words, repeats, lambda done, total: show('measuring', done, total), peers
        )
    if before is not None:
        report['compared'] = {'with': str(old), **compare(report, before)}
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        _print(report)


def _print(report: Report) -> None:
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    console.print(_line(report['machine']), soft_wrap=True, markup=False)
    compared = report.get('compared')
    table = Table(box=None, pad_edge=False)
    table.add_column('', no_wrap=True)
    for heading in ('median', 'spread', 'least', 'cpu', 'runs', 'real time'):
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
    console.print('spread: between the quartiles, as a share of the median', style='dim')
    if compared:
        console.print(f'new/old: ratio of medians, old: {compared["with"]}', soft_wrap=True)
        for fact, (was, now) in compared['differences'].items():
            console.print(f'not the same machine: {fact} was {was}, is {now}', soft_wrap=True)


def _line(facts: Mapping[str, Any]) -> str:
    return ', '.join(f'{name.replace("_", " ")} {value}' for name, value in facts.items())


def _cells(figure: Mapping[str, Any]) -> list[str]:
    median, factor = figure['median_s'], figure['real_time_factor']
    return [
        _time(median),
        f'{(figure["q3_s"] - figure["q1_s"]) / median:.0%}' if median > 0 else '',
        _time(figure['min_s']),
        '' if figure['cpu_s'] is None else _time(figure['cpu_s']),
        str(figure['repeats']),
        '' if factor is None else f'{factor:.0f}x',
    ]


def _time(seconds: float) -> str:
    """A time in three digits and its unit."""
    for unit, size in (('s', 1.0), ('ms', 1e-3)):
        if seconds >= size:
            value = seconds / size
            return f'{value:.0f} {unit}' if value >= 100 else f'{value:.3g} {unit}'
    return f'{seconds * 1e6:.3g} us'
