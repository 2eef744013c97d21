"""``taxinet evaluate``: measure a network's errors on single frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from taxinet_ros.cli.completion import complete_program
from taxinet_ros.cli.options import (
    JsonOption,
    PerceptionOption,
    RendererOption,
    refuse_given,
)
from taxinet_ros.cli.show import line_console, print_json, print_table

if TYPE_CHECKING:
    from taxinet_ros.training.evaluation import SliceErrors

_QUANTITIES = {'cte_m': ('cross-track', 'm'), 'he_deg': ('heading', 'deg')}


def evaluate(
    context: typer.Context,
    source: Annotated[
        str,
        typer.Argument(
            metavar='SCENARIO|DIR', autocompletion=complete_program,
            help='program to render pictures of, or folder of labelled images',
        ),
    ],
    perception: PerceptionOption = 'taxinet',
    images: Annotated[int, typer.Option(help='images to render, one per scene')] = 2_000,
    seed: Annotated[
        int, typer.Option(min=0, help='seed of the scenes; must differ from that of the training')
    ] = 2,
    camera: RendererOption = 'ours',
    workers: Annotated[int, typer.Option(help='rendering processes')] = 2,
    as_json: JsonOption = False,
) -> None:
    """Measure a network's errors on single frames.

    On rendered scenes, by light and position, or on a folder of labelled images.
    """
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.cli.training.pictures import picture_sources
    from taxinet_ros.core.provenance import provenance
    from taxinet_ros.core.renderer import OURS
    from taxinet_ros.training.evaluation import (
        evaluate_folder,
        evaluate_program,
        image_perception,
    )

    program, folders = picture_sources([source])
    if program is None:
        why = 'for rendered scenes; of a folder every image is read in order, leave it out'
        refuse_given(context, ('images', 'seed', 'camera', 'workers'), why)
    looker = image_perception(perception)
    with stage_bars(Console(stderr=as_json)) as show:
        if program is None:
            rows = evaluate_folder(looker, folders[0], show)
        else:
            rows = evaluate_program(
                looker, program, images=images, seed=seed, workers=workers, progress=show,
                camera=camera,
            )
    facts = {'perception': perception, 'fingerprint': looker.fingerprint}
    facts |= {'data': source} if program is None else {'program': program, 'seed': str(seed)}
    facts |= {} if camera == OURS else {'camera': camera}
    if as_json:
        print_json({**facts, 'made_on': provenance(), 'slices': rows})
        return
    _print_errors(rows, ', '.join(f'{name} {value}' for name, value in facts.items()))


def _print_errors(rows: Sequence[SliceErrors], title: str) -> None:
    console = line_console()
    console.print(title)
    headings = ['\nimages', '\nn', 'no\nestimate']
    for name, unit in _QUANTITIES.values():
        headings += [f'{name}\nMAE [{unit}]', '\np99']
    print_table(console, headings, [
        (row.name, str(row.images), str(row.without_estimate),
         *(cell for quantity in _QUANTITIES for cell in _error_cells(row, quantity)))
        for row in rows if row.images
    ])
    console.print('MAE: mean absolute error, with its 95 % confidence interval', style='dim')
    for quantity, turned in rows[0].mirrored.items():
        (name, unit), error = _QUANTITIES[quantity], rows[0].errors[quantity]['mae']
        console.print(
            f'{name}: the estimates fall where the truth rises. With the other sign, the MAE would '
            f'be {turned:.3g} {unit} instead of {error:.3g}: left is positive; see "positive" in '
            'the description of a network in ONNX, or the signs of its labels.', style='bold',
        )
    for quantity, guess in rows[0].guessed.items():
        (name, unit), error = _QUANTITIES[quantity], rows[0].errors[quantity]['mae']
        console.print(
            f'{name}: always answering the median would err by {guess:.3g} {unit}, less than '
            f'{error:.3g}: look at the order of the outputs, their units and the preparation of '
            'the pictures.', style='bold',
        )


def _error_cells(row: SliceErrors, quantity: str) -> tuple[str, str]:
    if not row.errors:
        return '-', '-'
    errors, half = row.errors[quantity], row.half_widths[quantity]
    interval = '' if half is None else f' ± {half:.3f}'
    return f'{errors["mae"]:.3f}{interval}', f'{errors["p99"]:.2f}'
