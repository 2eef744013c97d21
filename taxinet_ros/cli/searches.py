"""``taxinet bench searches``: what the samplers find, where it is known what there is."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

from taxinet_ros.bench.landscapes import APART, LANDSCAPES
from taxinet_ros.bench.searches import measure_searches
from taxinet_ros.cli.progress import measured


def run_searches(words: Sequence[str], *, repeats: int, as_json: bool) -> int:
    """Measure and print.

    Args:
        words: samplers and landscapes; none for the usual ones.
        repeats: searches for each landscape and sampler.
        as_json: print JSON.

    Returns:
        Exit code 0.

    Raises:
        UsageError: an unknown word, or no repetition.
    """
    return measured(partial(measure_searches, words, repeats), _print, as_json=as_json)


def _print(found: dict[str, Any], console: Console) -> None:
    console.print(f'{found["repeats"]} searches of {found["runs"]} runs for each line')
    table = Table(box=None, pad_edge=False)
    for heading in ('landscape', 'sampler'):
        table.add_column(heading, no_wrap=True)
    for heading in ('found', 'regions', 'failures', 'distinct', 'ask'):
        table.add_column(heading, justify='right', no_wrap=True)
    last = ''
    for one in found['searches']:
        table.add_row(
            '' if one['landscape'] == last else one['landscape'], one['sampler'],
            f'{one["found"]:.0%}', f'{one["regions"]:.0%}', f'{one["failures"]:.1f}',
            f'{one["distinct"]:.1f}', f'{1e3 * one["ask_s"]:.2f} ms',
        )
        last = one['landscape']
    console.print(table)
    console.print(
        'found: searches with a failure; regions: share of the failure regions found; distinct: '
        f'failures of another category, or {APART:g} of a dimension apart; ask: processor time',
        style='dim', soft_wrap=True,
    )
    for name in dict.fromkeys(one['landscape'] for one in found['searches']):
        console.print(f'{name}: {LANDSCAPES[name].meaning}', style='dim', soft_wrap=True)
