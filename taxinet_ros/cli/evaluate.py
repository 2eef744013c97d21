"""``taxinet evaluate``: a table of how far a perception's estimates lie from the truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.provenance import provenance
from taxinet_ros.training.evaluate import (
    SliceErrors,
    evaluate_folder,
    evaluate_program,
    seeing_perception,
)

_QUANTITIES = {'cte_m': ('cross-track', 'm'), 'he_deg': ('heading', 'deg')}


def run_evaluate(
    program: str | None,
    folder: Path | None,
    *,
    perception: str,
    images: int,
    seed: int,
    workers: int,
    as_json: bool,
) -> None:
    """Measure a perception on a program's scenes or a folder's images, and print the errors.

    Raises:
        UsageError: both or neither given, or something that cannot be used.
        InfraError: a worker process died, or the simulator failed.
    """
    if (program is None) == (folder is None):
        raise UsageError('evaluate: name either a program or --data, what to look at')
    looker = seeing_perception(perception)
    with stage_bars(Console(stderr=as_json)) as show:
        if folder is not None:
            rows = evaluate_folder(looker, folder, show)
        else:
            assert program is not None
            rows = evaluate_program(
                looker, program, images=images, seed=seed, workers=workers, progress=show
            )
    facts = {'perception': perception, 'fingerprint': looker.fingerprint}
    facts |= {'data': str(folder)} if folder else {'program': str(program), 'seed': str(seed)}
    if as_json:
        values = {**facts, 'made_on': dict(provenance()), 'slices': [asdict(row) for row in rows]}
        print(json.dumps(values, indent=2))
        return
    _print(rows, ', '.join(f'{name} {value}' for name, value in facts.items()))


def _print(rows: Sequence[SliceErrors], title: str) -> None:
    console = Console(highlight=False)
    console.print(title, soft_wrap=True, markup=False)
    table = Table(box=None, pad_edge=False)
    table.add_column('\nimages', no_wrap=True)
    for heading in ('\nn', 'no\nestimate'):
        table.add_column(heading, justify='right')
    for name, unit in _QUANTITIES.values():
        table.add_column(escape(f'{name}\nMAE [{unit}]'), justify='right', no_wrap=True)
        table.add_column('\np99', justify='right')
    for row in rows:
        cells = [cell for quantity in _QUANTITIES for cell in _cells(row, quantity)]
        table.add_row(row.name, str(row.images), str(row.without_estimate), *cells)
    console.print(table)
    console.print('MAE: mean absolute error, with its 95 % confidence interval', style='dim')


def _cells(row: SliceErrors, quantity: str) -> tuple[str, str]:
    if not row.errors:
        return '-', '-'
    errors, half = row.errors[quantity], row.half_widths[quantity]
    interval = '' if half is None else f' ± {half:.3f}'
    return f'{errors["mae"]:.3f}{interval}', f'{errors["p99"]:.2f}'
