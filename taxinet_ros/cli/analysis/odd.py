"""``taxinet odd``: an operational design domain, and what campaigns cover of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from taxinet_ros.cli.checked import check_new_file
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console, print_json, print_table
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.analysis.odd.coverage import OddCoverage
    from taxinet_ros.analysis.runs.campaign import GroupRate

WIDTH = 110
"""Columns of tables where they are not printed to a terminal."""
odd_app = command_group('Operational design domains (ODD), and what campaigns cover of one.')
_OddArgument = Annotated[
    str, typer.Argument(metavar='ODD', help='name of a shipped ODD, or a YAML file (docs/odd.md)')
]


@odd_app.command('show')
def show(odd: _OddArgument, as_json: JsonOption = False) -> int:
    """Check an ODD, and print its parameters, cells and exclusions."""
    from taxinet_ros.analysis.odd.coverage import NAMES, STRENGTHS
    from taxinet_ros.trials.odd.odd_file import find_odd, read_odd

    found = read_odd(find_odd(odd))
    counts = {
        t: sum(int(mask.sum()) for mask in found.feasible(t).values())
        for t in STRENGTHS if t <= len(found.parameters)
    }
    if as_json:
        print_json({
            'name': found.name, 'source': found.source, 'sha256': found.digest,
            'parameters': [
                {'key': one.key, 'unit': one.field.unit, 'source': one.source,
                 'cells': [cell.label for cell in one.cells]} for one in found.parameters
            ],
            'excluded': [{'when': one.text, 'why': one.why} for one in found.exclusions],
            'feasible': {NAMES[t]: count for t, count in counts.items()},
        })
        return ExitCode.OK
    console = line_console(width=WIDTH)
    source = f': {found.source}' if found.source else ''
    console.print(f'ODD {found.name}{source}')
    table = Table(box=None, pad_edge=False)
    for heading in ('parameter', 'cells', 'source'):
        table.add_column(heading)
    for one in found.parameters:
        table.add_row(one.field.label, ', '.join(cell.label for cell in one.cells), one.source)
    console.print(table, soft_wrap=False)
    for exclusion in found.exclusions:
        console.print(f'excluded: {exclusion.text} ({exclusion.why})')
    console.print('feasible: ' + ', '.join(f'{count:,} {NAMES[t]}' for t, count in counts.items()))
    return ExitCode.OK


@odd_app.command('coverage')
def coverage(
    campaigns: Annotated[
        list[Path],
        typer.Argument(
            metavar='CAMPAIGN...', help='folders of campaigns, or .parquet tables, of one system'
        ),
    ],
    odd: Annotated[
        str, typer.Option(metavar='NAME|FILE.yaml', help='the operational design domain')
    ],
    spec: Annotated[
        str | None,
        typer.Option(metavar='NAME', help='formula that defines failure (default: the headline)'),
    ] = None,
    below: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='also count the cells and combinations that fail less often than '
            'this, at 95 %'
        ),
    ] = None,
    strength: Annotated[
        int, typer.Option(min=1, max=3, help='largest number of cells in a combination')
    ] = 3,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.png', writable=True, dir_okay=False, help='picture of cells and pairs '
            'of cells'
        ),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Measure what the judged runs of campaigns cover of an ODD.

    Runs inside and outside; runs and failure rate of each cell; the share of all pairs and triples
    of cells with a run; the gaps; the largest hole between runs; parameters that were never varied,
    or that the ODD does not mention.
    """
    from taxinet_ros.analysis.odd.coverage import (
        STRENGTHS,
        coverage_json,
        coverage_lines,
        odd_coverage,
    )
    from taxinet_ros.analysis.odd.picture import coverage_picture
    from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
    from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
    from taxinet_ros.files.atomic import write_atomically
    from taxinet_ros.trials.odd.odd_file import find_odd, read_odd

    if below is not None and not 0 < below < 1:
        raise UsageError(f'--below {below:g}: needs to be a share above 0 and below 1')
    if plot is not None and (plot.suffix != '.png' or not plot.parent.is_dir() or plot.exists()):
        raise UsageError(f'--plot {plot}: expected a new .png file in an existing folder')
    domain = read_odd(find_odd(odd))
    first = read_runs(campaigns[0], spec)
    runs = [first, *(read_runs(path, first.spec) for path in campaigns[1:])]
    found = odd_coverage(
        domain, distinct_labels(runs), strengths=[t for t in STRENGTHS if t <= strength],
        limit=below,
    )
    if as_json:
        print_json(coverage_json(found))
    else:
        before, after = coverage_lines(found, odd, runs)
        console = line_console(width=WIDTH)
        console.print(before)
        print_table(
            console, ('parameter', 'cell', 'runs', 'failed', 'failing (95 %)'), _cells(found),
            left=2,
        )
        console.print(after)
    if plot is not None:
        write_atomically(plot, png_bytes(coverage_picture(found), LIGHT))
        if not as_json:
            print(f'picture: {plot}')
    return ExitCode.OK


@odd_app.command('export')
def export(
    odd: _OddArgument,
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE.yaml', writable=True, dir_okay=False, help='file to write; must be new'
        ),
    ],
) -> int:
    """Write an ODD as ASAM OpenODD 1.0 YAML, with a binding file for openodd-py beside it."""
    from taxinet_ros.files.atomic import write_atomically
    from taxinet_ros.trials.odd.odd_file import find_odd, read_odd
    from taxinet_ros.trials.odd.openodd import binding_path, openodd_texts

    found = read_odd(find_odd(odd))
    paths = (out, binding_path(out))
    for path in paths:
        check_new_file(path)
    for path, text in zip(paths, openodd_texts(found, out.name), strict=True):
        write_atomically(path, text)
    print(f'written: {paths[0]} (ASAM OpenODD 1.0), {paths[1].name} (for openodd-py)')
    return ExitCode.OK


def _cells(found: OddCoverage) -> Iterator[tuple[str, ...]]:
    for one in found.cells:
        parameter = found.odd.parameters[one.parameter]
        yield (
            parameter.field.label if one.cell == 0 else '', parameter.cells[one.cell].label,
            f'{one.rate.runs:,}', f'{one.rate.failures:,}', _rate_words(one.rate),
        )
    yield '', 'all', f'{found.inside:,}', f'{found.rate.failures:,}', _rate_words(found.rate)


def _rate_words(rate: GroupRate) -> str:
    if rate.runs and math.isnan(rate.low):
        return 'no rate: a sampler chose them'
    return rate.words()
