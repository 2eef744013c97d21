"""``taxinet dataset``, ``train`` and ``evaluate``: make images, train a network, measure it."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from taxinet_ros.cli.checked import check_output
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.perception.domain import domain_words
from taxinet_ros.core.perception.weights import card_path
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.renderer import OURS
from taxinet_ros.errors import UsageError
from taxinet_ros.processes.interrupts import ToldInterrupt
from taxinet_ros.training.data.dataset_folder import LABELS, DatasetOptions, write_dataset
from taxinet_ros.training.data.unfinished import is_begun
from taxinet_ros.training.evaluation import (
    SliceErrors,
    evaluate_folder,
    evaluate_program,
    image_perception,
)
from taxinet_ros.training.options import TrainOptions
from taxinet_ros.training.train import train


def run_dataset(options: DatasetOptions) -> None:
    """Make or continue a dataset, and print its state."""
    try:
        with stage_bars(Console()) as show:
            rendered = write_dataset(options, show)
    except KeyboardInterrupt:
        if is_begun(options.out):
            Console(stderr=True).print(
                f'interrupted; images in {options.out} are kept, continue with --resume',
                soft_wrap=True, highlight=False,
            )
            raise ToldInterrupt from None
        raise
    Console(highlight=False).print(
        f'{options.count} images in {options.out}, {rendered} of them rendered now; labels: '
        f'{options.out / LABELS}',
        soft_wrap=True,
    )


def run_train(options: TrainOptions) -> None:
    """Train, with a bar per stage, and print the errors on the validation images.

    Raises:
        UsageError: an option is invalid, or a file beside the weights would replace a record.
    """
    beside = card_path(options.out), options.curves_path, options.history_path
    for path in beside if options.out.suffix else ():
        check_output(f'train: --out {options.out}: {path}', path)
    console = Console(highlight=False)
    try:
        with stage_bars(console) as show:
            card = train(options, show)
    except KeyboardInterrupt:
        if not options.unfinished.exists():
            raise
        words = [word for word in sys.argv[1:] if word != '--resume']
        Console(stderr=True).print(
            f'interrupted; {options.unfinished} keeps pictures and epochs, continue with '
            f'{shlex.join(["taxinet", *words, "--resume"])}',
            soft_wrap=True, highlight=False, markup=False,
        )
        raise ToldInterrupt from None
    for quantity, errors in card.errors.items():
        figures = ', '.join(f'{name} {value:.3g}' for name, value in errors.items())
        console.print(f'{quantity}: {figures}', soft_wrap=True)
    console.print(f'domain: {domain_words(card.domain)}', soft_wrap=True)
    console.print(
        f'weights: {options.out} (epoch {card.best_epoch}), model card: {card_path(options.out)}, '
        f'learning curves: {options.curves_path}, {options.history_path.name}',
        soft_wrap=True,
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
    camera: str = OURS,
) -> None:
    """Measure a perception on a program's scenes or a folder's images, and print the errors.

    Raises:
        UsageError: both or neither given, or one is unusable.
        InfraError: a worker process died, or the simulator failed.
    """
    if (program is None) == (folder is None):
        raise UsageError('evaluate: give either a program or --data')
    looker = image_perception(perception)
    with stage_bars(Console(stderr=as_json)) as show:
        if folder is not None:
            rows = evaluate_folder(looker, folder, show)
        else:
            assert program is not None
            rows = evaluate_program(
                looker, program, images=images, seed=seed, workers=workers, progress=show,
                camera=camera,
            )
    facts = {'perception': perception, 'fingerprint': looker.fingerprint}
    facts |= {'data': str(folder)} if folder else {'program': str(program), 'seed': str(seed)}
    facts |= {} if camera == OURS else {'camera': camera}
    if as_json:
        values = {**facts, 'made_on': dict(provenance()), 'slices': [asdict(row) for row in rows]}
        print(json.dumps(values, indent=2))
        return
    _print_errors(rows, ', '.join(f'{name} {value}' for name, value in facts.items()))


def _print_errors(rows: Sequence[SliceErrors], title: str) -> None:
    console = Console(highlight=False)
    console.print(title, soft_wrap=True, markup=False)
    table = Table(box=None, pad_edge=False)
    table.add_column('\nimages', no_wrap=True)
    for heading in ('\nn', 'no\nestimate'):
        table.add_column(heading, justify='right')
    for name, unit in _QUANTITIES.values():
        table.add_column(escape(f'{name}\nMAE [{unit}]'), justify='right', no_wrap=True)
        table.add_column('\np99', justify='right')
    for row in (row for row in rows if row.images):
        cells = [cell for quantity in _QUANTITIES for cell in _error_cells(row, quantity)]
        table.add_row(row.name, str(row.images), str(row.without_estimate), *cells)
    console.print(table)
    console.print('MAE: mean absolute error, with its 95 % confidence interval', style='dim')
    for quantity, turned in rows[0].mirrored.items():
        (name, unit), error = _QUANTITIES[quantity], rows[0].errors[quantity]['mae']
        console.print(
            f'{name}: the estimates fall where the truth rises. With the other sign, the MAE would '
            f'be {turned:.3g} {unit} instead of {error:.3g}: left is positive; see "positive" in '
            'the description of a network in ONNX, or the signs of its labels.',
            soft_wrap=True, style='bold',
        )


def _error_cells(row: SliceErrors, quantity: str) -> tuple[str, str]:
    if not row.errors:
        return '-', '-'
    errors, half = row.errors[quantity], row.half_widths[quantity]
    interval = '' if half is None else f' ± {half:.3f}'
    return f'{errors["mae"]:.3f}{interval}', f'{errors["p99"]:.2f}'
