"""``taxinet bench intervals``, ``rare``, ``sequential`` and ``searches``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

from taxinet_ros.bench.intervals import measure_intervals
from taxinet_ros.bench.rare import LANDSCAPES as RARE
from taxinet_ros.bench.rare import METHODS, measure_rare
from taxinet_ros.bench.searches import APART, LANDSCAPES, measure_searches
from taxinet_ros.bench.sequential import measure_sequential
from taxinet_ros.cli.progress import run_with_progress
from taxinet_ros.errors import UsageError


def run_intervals(samplers: Sequence[str], *, repeats: int, as_json: bool) -> int:
    """Measure and print.

    Args:
        samplers: words; none for the default ones.
        repeats: searches for each sampler and failure rate.
        as_json: print JSON.

    Returns:
        Exit code 0.

    Raises:
        UsageError: an unknown sampler, or ``repeats`` below 1.
    """
    return run_with_progress(
        partial(measure_intervals, samplers, repeats), _print_intervals, as_json=as_json
    )


def _print_intervals(found: dict[str, Any], console: Console) -> None:
    runs = ', '.join(f'{number:,}' for number in found['runs'])
    console.print(
        f'{found["repeats"]} searches for each line, {", ".join(found["landscapes"])} in turn; '
        f'after {runs} runs', soft_wrap=True,
    )
    table = Table(box=None, pad_edge=False)
    table.add_column('sampler', no_wrap=True)
    for heading in ('fail', 'runs', 'drawn', 'covers', 'width', 'gate', 'watched', 'gate, watched'):
        table.add_column(heading, justify='right', no_wrap=True)
    for one in found['intervals']:
        for number, runs_made in enumerate(found['runs']):
            last = number + 1 == len(found['runs'])
            table.add_row(
                one['sampler'], f'{100 * one["rate"]:g} %', f'{runs_made:,}',
                f'{one["drawn"][number]:.0f}',
                *(f'{100 * one[name][number]:.1f} %' for name in ('covers', 'width', 'passes')),
                *(f'{100 * one[name]:.1f} %' if last else ''
                  for name in ('watched_covers', 'watched_passes')),
            )
    console.print(table)
    console.print(
        'covers: share of 95 % intervals that contain the rate, and their median width. gate: '
        'wrong passes at exactly the true rate, at most 5 %. watched: the same with a look every '
        f'{found["look"]} runs and stopping at will', style='dim', soft_wrap=True,
    )


def run_sequential(words: Sequence[str], *, repeats: int, as_json: bool) -> int:
    """Simulate sequential tests and print.

    Args:
        words: none.
        repeats: campaigns for each test and true rate.
        as_json: print JSON.

    Returns:
        Exit code 0.

    Raises:
        UsageError: words are given, or ``repeats`` is below 1.
    """
    if words:
        raise UsageError(f'bench sequential: {words[0]}: it takes no further words')
    return run_with_progress(
        partial(measure_sequential, repeats), _print_sequential, as_json=as_json
    )


def _print_sequential(found: dict[str, Any], console: Console) -> None:
    console.print(f'{found["repeats"]} campaigns for each line')
    table = Table(box=None, pad_edge=False)
    table.add_column('test', no_wrap=True)
    for heading in ('satisfied', 'PASS', 'exact', 'FAIL', 'not design', 'open', 'runs', 'exact',
                    'fixed'):
        table.add_column(heading, justify='right', no_wrap=True)
    last = ''
    for one in found['sequential']:
        table.add_row(
            '' if one['test'] == last else one['test'].removeprefix('min-satisfaction='),
            f'{100 * one["satisfied"]:.5g} %',
            *(f'{100 * one[name]:.1f} %' for name in (
                'passes', 'exact_passes', 'fails', 'below_design', 'open')),
            *(f'{one[name]:,.0f}' for name in ('mean_runs', 'exact_mean_runs', 'fixed_runs')),
        )
        last = one['test']
    console.print(table)
    console.print(
        'test: --until min-satisfaction=…; satisfied: the true share; not design: ended as not as '
        'good as the design; open: no decision within six times the fixed number; runs: on '
        'average; fixed: runs of a campaign judged once that errs as seldom', style='dim',
        soft_wrap=True,
    )


def run_rare(words: Sequence[str], *, repeats: int, seed: int, as_json: bool) -> int:
    """Estimate known probabilities of failure and print.

    Args:
        words: landscapes; none for all.
        repeats: estimates for each landscape and probability.
        seed: of the first of them.
        as_json: print JSON.

    Returns:
        Exit code 0.

    Raises:
        UsageError: an unknown landscape, or ``repeats`` below 1.
    """
    return run_with_progress(
        partial(measure_rare, words, repeats, seed=seed), _print_rare, as_json=as_json
    )


def _print_rare(found: dict[str, Any], console: Console) -> None:
    console.print(
        f'{found["repeats"]} estimates for each line, of at most {found["most_runs"]:,} runs'
    )
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    table.add_column('landscape', no_wrap=True)
    for heading in ('fails', 'runs', 'plain', 'holds', '95 %', 'miss', 'ends', 'all plain', 'gain'):
        table.add_column(heading, justify='right', no_wrap=True)
    last = ''
    for one in found['rare']:
        split = one['splitting']
        table.add_row(
            '' if one['landscape'] == last else one['landscape'], f'{one["probability"]:.0e}',
            f'{one["runs"]:,.0f}', f'{one["plainly"]:.0%}', f'{split["covers"]:.1%}',
            f'{100 * split["covers_low"]:.0f}–{100 * split["covers_high"]:.0f}',
            f'{split["above"]}/{split["below"]}',
            *(f'{one[method]["low"]:.2g}–{one[method]["high"]:.2g}' for method in METHODS),
            f'{split["gain"]:.2g}',
        )
        last = one['landscape']
    console.print(table)
    console.print(
        'plain: estimates that drew plainly; holds: intervals that contain the probability, with a '
        '95 % interval of this share; miss: how many the probability is above/below of; ends: '
        'medians over the probability, and those of as many plain draws; gain: runs that plain '
        'draws need for the same mean square error, over those spent', style='dim', soft_wrap=True,
    )
    for name in dict.fromkeys(one['landscape'] for one in found['rare']):
        console.print(f'{name}: {RARE[name].meaning}', style='dim', soft_wrap=True)


def run_searches(words: Sequence[str], *, repeats: int, as_json: bool) -> int:
    """Measure and print.

    Args:
        words: samplers and landscapes; none for the default ones.
        repeats: searches for each landscape and sampler.
        as_json: print JSON.

    Returns:
        Exit code 0.

    Raises:
        UsageError: an unknown word, or ``repeats`` below 1.
    """
    return run_with_progress(
        partial(measure_searches, words, repeats), _print_searches, as_json=as_json
    )


def _print_searches(found: dict[str, Any], console: Console) -> None:
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
        f'failures that differ in category, or by {APART:g} of a dimension; ask: processor time',
        style='dim', soft_wrap=True,
    )
    for name in dict.fromkeys(one['landscape'] for one in found['searches']):
        console.print(f'{name}: {LANDSCAPES[name].meaning}', style='dim', soft_wrap=True)
