"""``taxinet bench``: timings on this machine, compared with others and among themselves."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.cli.show import print_table
from taxinet_ros.errors import ExitCode, UsageError

_WIDTH = 100
"""Width of the table [columns] when written to a file."""


def bench(
    subjects: Annotated[
        list[str] | None,
        typer.Argument(metavar='[SUBJECT]...', help='camera, loop, graph (default: all)'),
    ] = None,
    repeats: Annotated[int, typer.Option(help='number of measurements of each subject, '
    'interleaved')] = 40,
    as_json: Annotated[bool, typer.Option('--json', help='print JSON')] = False,
    compare: Annotated[
        Path | None, typer.Option(metavar='OLD.json', help='earlier JSON report to compare with')
    ] = None,
    guard: Annotated[
        bool, typer.Option('--guard', help='exit 1 if a guarded ratio is out of bounds')
    ] = False,
) -> None:
    """Benchmark camera, closed loop and graph on one core.

    Prints medians, spreads and ratios: camera frames with their stages, the closed loop without ROS
    and over ROS 2, composed or one process per node. Compare two commits on one machine with --json
    and --compare.
    """
    from taxinet_ros.bench.report import compare_reports, load_report, ratio_violations
    from taxinet_ros.bench.run import GRAPH, run_subjects

    words = subjects or []
    if guard and words and GRAPH not in words:
        raise UsageError(f'bench: --guard checks the ratios of the graph; name {GRAPH}')
    before = None if compare is None else load_report(compare)
    with stage_bars(Console(stderr=as_json)) as show:
        report = run_subjects(words, repeats, lambda done, total: show('measuring', done, total))
    if before is not None:
        report['compared'] = {'with': str(compare), **compare_reports(report, before)}
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        print_report(report)
    violated = ratio_violations(report.get('ratios', {})) if guard else []
    for line in violated:
        print(line, file=sys.stderr)
    raise typer.Exit(ExitCode.VIOLATED if violated else ExitCode.OK)


def print_report(report: Mapping[str, Any]) -> None:
    """Print the figures of a report, its ratios, and what it was compared with."""
    console = Console(emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    facts = (f'{name.replace("_", " ")} {value}' for name, value in report['machine'].items())
    console.print(', '.join(facts), soft_wrap=True, markup=False)
    compared = report.get('compared')
    headings = ['median', 'spread', 'least', 'cpu', 'runs', 'real time', 'per core']
    rows = []
    for name, figure in report['figures'].items():
        part = name.split('/', 2)[2:]
        rows.append([f'  {part[0]}' if part else name, *_cells(figure)])
        if compared:
            ratio = compared['ratios'].get(name)
            rows[-1].append('-' if ratio is None else f'{ratio:.2f}')
    print_table(console, ('', *headings, *(['new/old'] if compared else [])), rows)
    console.print(
        'spread: interquartile range, as a share of the median; real time: simulated time per '
        'wall-clock time, and per processor time', style='dim', soft_wrap=True,
    )
    if ratios := report.get('ratios'):
        print_table(console, ('ratio of processor times', 'value', 'quartiles', 'guarded'), [
            [name, f'{ratio["value"]:.2f}', f'{ratio["low"]:.2f} .. {ratio["high"]:.2f}',
             '' if ratio['most'] is None else f'<= {ratio["most"]:g}']
            for name, ratio in ratios.items()
        ])
    if compared:
        console.print(f'new/old: ratio of medians, old: {compared["with"]}', soft_wrap=True)
        for fact, (was, now) in compared['differences'].items():
            console.print(f'not the same machine: {fact} was {was}, is {now}', soft_wrap=True)


def _cells(figure: Mapping[str, Any]) -> list[str]:
    median = figure['median_s']
    factors = (figure['real_time_factor'], figure['real_time_per_core'])
    return [
        time_text(median),
        f'{(figure["q3_s"] - figure["q1_s"]) / median:.0%}' if median > 0 else '',
        time_text(figure['min_s']),
        '' if figure['cpu_s'] is None else time_text(figure['cpu_s']),
        str(figure['repeats']),
        *('' if factor is None else f'{factor:.3g}x' for factor in factors),
    ]


def time_text(seconds: float) -> str:
    """A time with three digits and its unit."""
    for unit, size in (('s', 1.0), ('ms', 1e-3)):
        if seconds >= size:
            value = seconds / size
            return f'{value:.0f} {unit}' if value >= 100 else f'{value:.3g} {unit}'
    return f'{seconds * 1e6:.3g} us'
