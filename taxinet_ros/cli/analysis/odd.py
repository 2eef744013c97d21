"""``taxinet odd``: an operational design domain, and what campaigns cover of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from taxinet_ros.cli.analysis.odd_coverage import WIDTH, coverage
from taxinet_ros.cli.checked import check_new_file
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode

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


odd_app.command('coverage')(coverage)


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
