"""``taxinet estimate``: the probability of rare failures by splitting."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence

from rich.console import Console

from taxinet_ros.analysis.search.rare import (
    estimate_lines,
    estimate_of,
    estimate_values,
    write_estimate,
)
from taxinet_ros.campaign.samplers.splitting import RareEstimate, State
from taxinet_ros.campaign.search import Search, search_heading, space_lines
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.campaign.summary import requirement_lines
from taxinet_ros.cli.run.search import open_search, run_on_workers, search_view
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode
from taxinet_ros.nodes.running.domain import check_workers


def run_estimate(options: SearchOptions, *, quiet: bool, as_json: bool) -> int:
    """Run the chains, and print and write the estimate.

    Args:
        options: options of the search, by the sampler ``splitting``.
        quiet: print warnings and the result only.
        as_json: print the result as JSON, and all else on standard error.

    Returns:
        Exit code: 0 estimated with the error asked for, 3 an upper limit, unclear, or a greater
        error, 4 runs without a result ended it, 130 interrupted.

    Raises:
        UsageError: bad input.
    """
    check_workers(options.workers)
    console = Console(highlight=False, stderr=as_json)
    with open_search(options, console, quiet=True) as search:
        lines: list[str] = [search.book.warning] if search.book.warning else []
        if not quiet:
            lines += [search_heading(search.options), *space_lines(search.space), *search.notes]
        for line in lines:
            console.print(line, soft_wrap=True, markup=False)
        for requirement in requirement_lines(search.check, quiet=quiet):
            console.print(requirement, soft_wrap=True)
        with search_view(console, search, shown=console.is_terminal and not quiet):
            run_on_workers(search)
        found = estimate_of(search)
        whole = search.exhausted or not search.interrupted
        table, picture = write_estimate(found, search)
        values = estimate_values(found, search)
        told = estimate_lines(found, search)
    asked = float(options.sampler_options['error'])
    if as_json:
        print(json.dumps(values, indent=2, allow_nan=False))
    console.print('\n'.join(told), soft_wrap=True, markup=False)
    files = f'written: {table}' + (f', {picture.name}' if picture is not None else '')
    console.print(files, soft_wrap=True, markup=False)
    for line in _next_lines(found, search, asked):
        console.print(line, soft_wrap=True, markup=False)
    if not whole:
        return ExitCode.INTERRUPTED
    if not search.exhausted and search.stopped:
        return ExitCode.INFRA
    reached = found.state is State.ESTIMATED and found.relative_error <= asked
    return ExitCode.OK if reached else ExitCode.INCOMPLETE


def _next_lines(found: RareEstimate, search: Search, asked: float) -> Sequence[str]:
    """Why it ended, and the next useful command."""
    options = search.options
    out = shlex.quote(str(options.campaign.out))
    runs = options.campaign.runs
    why = 'interrupted' if search.interrupted else search.stopped
    lines = [f'ended: {why}'] if why else []
    failed = [row for row in search.rows if row.outcome is Outcome.FAIL]
    if search.interrupted or (search.stopped and not search.exhausted):
        lines.append('next: the same command with --resume continues it')
    elif found.state is State.AT_MOST and not search.exhausted:
        lines.append(
            f'next: the same command with --resume and --runs {2 * runs}; its islands were cut off'
        )
    elif found.state is State.UNCLEAR or (
        found.state is State.ESTIMATED and found.relative_error > asked > 0
    ):
        more = max(2.0, (found.relative_error / (asked or found.relative_error)) ** 2)
        lines.append(
            'next: the same command with --resume and --runs '
            f'{round(runs * min(more, 10.0), -2):.0f}'
        )
    elif failed:
        worst = min(failed, key=lambda row: row.headline[1] if row.headline else 0.0)
        lines.append(
            f'next: taxinet analyze {out} for causes, or taxinet explain '
            f'{shlex.quote(str(options.campaign.out / worst.run_id))} for the worst failure'
        )
    else:
        lines.append(f'next: taxinet analyze {out}')
    return lines
