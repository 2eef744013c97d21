"""``taxinet odd``: an operational design domain, and what campaigns cover of it."""

from __future__ import annotations

import dataclasses
import json
import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.analysis.odd.coverage import OddCoverage
    from taxinet_ros.analysis.runs.campaign import CampaignRuns, GroupRate
    from taxinet_ros.trials.odd.odd_file import Odd

_WIDTH = 110
_NAMES = {1: 'cells', 2: 'pairs', 3: 'triples'}

odd_app = command_group('Operational design domains (ODD), and what campaigns cover of one.')
_OddArgument = Annotated[
    str, typer.Argument(metavar='ODD', help='name of a shipped ODD, or a YAML file (docs/odd.md)')
]


@odd_app.command('show')
def show(odd: _OddArgument, as_json: JsonOption = False) -> int:
    """Check an ODD, and print its parameters, cells and exclusions."""
    from taxinet_ros.analysis.odd.coverage import STRENGTHS
    from taxinet_ros.trials.odd.odd_file import find_odd, read_odd

    found = read_odd(find_odd(odd))
    counts = {
        t: sum(int(mask.sum()) for mask in found.feasible(t).values())
        for t in STRENGTHS if t <= len(found.parameters)
    }
    if as_json:
        print(json.dumps({
            'name': found.name, 'source': found.source, 'sha256': found.digest,
            'parameters': [
                {'key': one.key, 'unit': one.field.unit, 'source': one.source,
                 'cells': [cell.label for cell in one.cells]} for one in found.parameters
            ],
            'excluded': [{'when': one.text, 'why': one.why} for one in found.exclusions],
            'feasible': {_NAMES[t]: count for t, count in counts.items()},
        }, indent=2))
        return ExitCode.OK
    console = _console()
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
    console.print('feasible: ' + ', '.join(f'{count:,} {_NAMES[t]}' for t, count in counts.items()))
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
    from taxinet_ros.analysis.odd.coverage import STRENGTHS, coverage_json, odd_coverage
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
        print(json.dumps(coverage_json(found), indent=2, allow_nan=False))
    else:
        _print(_console(), found, odd, runs)
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
        if path.exists():
            raise UsageError(f'--out {path}: already exists; name a new file')
    if not out.parent.is_dir():
        raise UsageError(f'--out {out}: no such folder: {out.parent}')
    for path, text in zip(paths, openodd_texts(found, out.name), strict=True):
        write_atomically(path, text)
    print(f'written: {paths[0]} (ASAM OpenODD 1.0), {paths[1].name} (for openodd-py)')
    return ExitCode.OK


def _print(
    console: Console, found: OddCoverage, name: str, runs: Sequence[CampaignRuns]
) -> None:
    """Print the coverage of an ODD, which the user calls by this name."""
    from taxinet_ros.core.scenario_fields import BY_KEY

    odd = found.odd
    outside = found.judged - found.inside
    console.print(
        f'ODD {odd.name}, {", ".join(found.campaigns)}, {found.spec}: {found.judged:,} judged '
        f'runs, {found.inside:,} inside, {outside:,} outside',
    )
    for why, count in found.outside.items():
        console.print(f'  outside: {count:,} {why}')
    for outcome, count in found.unjudged.items():
        console.print(f'  not judged, so they cover nothing: {count:,} {outcome}')
    for line in found.cautions:
        console.print(f'  note: {line}')
    console.print(_cell_table(found), soft_wrap=False)
    for one in found.strengths:
        below = '' if one.below is None else (
            f'; {one.below:,} fail in less than {100 * (found.limit or 0):g} % (95 %, each alone)'
        )
        console.print(
            f'{_NAMES[one.t]}: {one.covered:,} of {one.feasible:,} covered '
            f'({math.floor(1000 * one.share) / 10:g} %), {one.failing:,} with a failure{below}',
        )
    for gap in found.gaps:
        console.print(f'  gap: {found.gap_words(gap)}')
    _print_hole(console, found)
    for heading, keys in (
        ('never varied, though the ODD has more than one value', found.fixed),
        ('varied, but not in the ODD', found.unmentioned),
    ):
        if keys:
            labels = ', '.join(BY_KEY[key].label for key in keys)
            console.print(f'{heading}: {labels}')
    open_pairs = next((one for one in found.strengths if one.covered < one.feasible), None)
    if open_pairs is not None:
        words = (
            '--sampler', 'coverage', '--odd', name, '--sampler-option',
            f'strength={open_pairs.t}',
        )
        command = _falsify_words(odd, runs, words)
        console.print(f'fill them: {command}')


def _falsify_words(odd: Odd, runs: Sequence[CampaignRuns], words: Sequence[str]) -> str:
    """The command that searches further as one campaign of a shipped program did; else in words."""
    from taxinet_ros.core.scenario_fields import CATALOGUES
    from taxinet_ros.scenes.programs import SUFFIX, known_programs
    from taxinet_ros.trials.run_command import RunSettings

    one, program = runs[0], runs[0].program.removesuffix(SUFFIX)
    if len(runs) == 1 and one.facts and one.perception and program in known_programs():
        settings = RunSettings.from_facts(one.facts)
        # What was set of the ODD's own parameters is what leaves gaps.
        values = {
            key: value for key, value in settings.values.items()
            if key not in [parameter.key for parameter in odd.parameters]
        }
        settings = dataclasses.replace(settings, perception=one.perception, values=values)
        if not settings.timing.free and all(
            str(values[key]) in CATALOGUES[key].shipped for key in set(CATALOGUES) & set(values)
        ):
            return settings.command(program, *words, verb='falsify')
    return f'taxinet falsify PROGRAM {shlex.join(words)}, with the other options of these runs'


def _cell_table(found: OddCoverage) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column('parameter', no_wrap=True)
    table.add_column('cell', no_wrap=True)
    for heading in ('runs', 'failed', 'failing (95 %)'):
        table.add_column(heading, justify='right', no_wrap=True)
    for one in found.cells:
        parameter = found.odd.parameters[one.parameter]
        table.add_row(
            parameter.field.label if one.cell == 0 else '', parameter.cells[one.cell].label,
            f'{one.rate.runs:,}', f'{one.rate.failures:,}', _rate_words(one.rate),
        )
    table.add_row('', 'all', f'{found.inside:,}', f'{found.rate.failures:,}',
                  _rate_words(found.rate))
    return table


def _rate_words(rate: GroupRate) -> str:
    if rate.runs and math.isnan(rate.low):
        return 'no rate: a sampler chose them'
    return rate.words()


def _print_hole(console: Console, found: OddCoverage) -> None:
    from taxinet_ros.core.scenario_fields import BY_KEY

    if found.hole is None:
        return
    where = ', '.join(f'{BY_KEY[key].label} {value}' for key, value in found.hole_words().items())
    console.print(
        f'dispersion: at least {found.hole.radius:.2f} of each range from the nearest run, at '
        f'{where}; {found.inside:,} runs cannot have less than {found.hole.least:.2f}',
    )


def _console() -> Console:
    console = line_console()
    if not console.is_terminal:
        console.width = _WIDTH
    return console
