"""``taxinet odd``: an operational design domain, and what campaigns cover of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from taxinet_ros.cli.checked import check_new_file
from taxinet_ros.cli.options import JsonOption, refuse_given
from taxinet_ros.cli.show import line_console, print_json, print_table
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.analysis.odd.coverage import OddCoverage
    from taxinet_ros.analysis.runs.campaign import CampaignRuns, GroupRate
    from taxinet_ros.trials.odd.odd_file import Odd

WIDTH = 110
"""Columns of tables where they are not printed to a terminal."""


def odd(
    context: typer.Context,
    domain: Annotated[
        str,
        typer.Argument(metavar='ODD', help='name of a shipped ODD, or a YAML file (docs/odd.md)'),
    ],
    campaigns: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar='CAMPAIGN', help='folders of campaigns, or .parquet tables, of one system'
        ),
    ] = None,
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
    out: Annotated[
        Path | None,
        typer.Option(
            metavar='FILE.yaml', writable=True, dir_okay=False, help='also write the ODD as ASAM '
            'OpenODD 1.0, with a binding file for openodd-py beside it; must be new'
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check an operational design domain (ODD) and print its cells, or what campaigns cover of it.

    Of campaigns: judged runs inside and outside; runs and failure rate of each cell; the share of
    all pairs and triples of cells with a run; the gaps; parameters that were never varied, or
    that the ODD does not mention.
    """
    from taxinet_ros.analysis.odd.coverage import STRENGTHS, odd_coverage
    from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
    from taxinet_ros.trials.odd.odd_file import find_odd, read_odd
    from taxinet_ros.trials.odd.openodd import binding_path

    if not campaigns:
        refuse_given(context, ('spec', 'below', 'strength', 'plot'), 'only with a CAMPAIGN')
    if below is not None and not 0 < below < 1:
        raise UsageError(f'--below {below:g}: needs to be a share above 0 and below 1')
    if plot is not None and (plot.suffix != '.png' or not plot.parent.is_dir() or plot.exists()):
        raise UsageError(f'--plot {plot}: expected a new .png file in an existing folder')
    read = read_odd(find_odd(domain))
    for path in () if out is None else (out, binding_path(out)):
        check_new_file(path)
    if campaigns:
        first = read_runs(campaigns[0], spec)
        runs = [first, *(read_runs(path, first.spec) for path in campaigns[1:])]
        found = odd_coverage(
            read, distinct_labels(runs), strengths=[t for t in STRENGTHS if t <= strength],
            limit=below,
        )
        _print_coverage(found, domain, runs, as_json=as_json)
        if plot is not None:
            _draw(found, plot, quiet=as_json)
    else:
        _print_odd(read, as_json=as_json)
    if out is not None:
        _write_openodd(read, out, quiet=as_json)


def _print_odd(found: Odd, *, as_json: bool) -> None:
    from taxinet_ros.analysis.odd.coverage import NAMES, STRENGTHS

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
        return
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


def _print_coverage(
    found: OddCoverage, odd: str, runs: Sequence[CampaignRuns], *, as_json: bool
) -> None:
    from taxinet_ros.analysis.odd.coverage import coverage_json, coverage_lines

    if as_json:
        print_json(coverage_json(found))
        return
    before, after = coverage_lines(found, odd, runs)
    console = line_console(width=WIDTH)
    console.print(before)
    print_table(
        console, ('parameter', 'cell', 'runs', 'failed', 'failing (95 %)'), _cells(found), left=2,
    )
    console.print(after)


def _draw(found: OddCoverage, plot: Path, *, quiet: bool) -> None:
    from taxinet_ros.analysis.odd.picture import coverage_picture
    from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
    from taxinet_ros.files.atomic import write_atomically

    write_atomically(plot, png_bytes(coverage_picture(found), LIGHT))
    if not quiet:
        print(f'picture: {plot}')


def _write_openodd(found: Odd, out: Path, *, quiet: bool) -> None:
    from taxinet_ros.files.atomic import write_atomically
    from taxinet_ros.trials.odd.openodd import binding_path, openodd_texts

    paths = (out, binding_path(out))
    for path, text in zip(paths, openodd_texts(found, out.name), strict=True):
        write_atomically(path, text)
    if not quiet:
        print(f'written: {paths[0]} (ASAM OpenODD 1.0), {paths[1].name} (for openodd-py)')


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
        return 'no rate'
    return rate.words()
