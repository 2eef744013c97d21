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
    unfinished_words,
    write_estimate,
)
from taxinet_ros.cli.run.campaign import run_on_workers
from taxinet_ros.cli.run.search import open_search, search_view
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode
from taxinet_ros.nodes.running.domain import check_workers
from taxinet_ros.samplers.splitting import RareEstimate, State
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.search import Search
from taxinet_ros.trials.search_summary import heading_lines
from taxinet_ros.trials.summary import requirement_lines


def run_estimate(asked: Search, *, quiet: bool, as_json: bool) -> int:
    """Run the chains, and print and write the estimate.

    Args:
        asked: the search, by the sampler ``splitting``.
        quiet: print warnings and the result only.
        as_json: print the result as JSON, and all else on standard error.

    Returns:
        Exit code: 0 estimated, 3 a wide interval, or none as too few runs were asked for, 4 runs
        without a result ended it, 130 interrupted.

    Raises:
        UsageError: bad input.
    """
    check_workers(asked.campaign.workers)
    console = Console(highlight=False, stderr=as_json)
    with open_search(asked, console, quiet=True) as search:
        lines: list[str] = [search.book.warning] if search.book.warning else []
        if not quiet:
            lines += heading_lines(asked)
        for line in lines:
            console.print(line, soft_wrap=True, markup=False)
        for requirement in requirement_lines(asked.check, quiet=quiet):
            console.print(requirement, soft_wrap=True)
        with search_view(console, search, shown=console.is_terminal and not quiet):
            run_on_workers(search)
        if unfinished := unfinished_words(search):
            if as_json:
                none = {'state': 'unfinished', 'low': None, 'high': None, 'why': unfinished}
                print(json.dumps(none, indent=2))
            console.print(unfinished, soft_wrap=True, markup=False)
            return _exit_code(search, ExitCode.INCOMPLETE)
        found = estimate_of(search)
        table, picture = write_estimate(found, search)
        values = estimate_values(found, search)
        told = estimate_lines(found, search)
    if as_json:
        print(json.dumps(values, indent=2, allow_nan=False))
    console.print('\n'.join(told), soft_wrap=True, markup=False)
    files = f'written: {table}' + (f', {picture.name}' if picture is not None else '')
    console.print(files, soft_wrap=True, markup=False)
    for line in _next_lines(found, search):
        console.print(line, soft_wrap=True, markup=False)
    estimated = found.state is State.ESTIMATED
    return _exit_code(search, ExitCode.OK if estimated else ExitCode.INCOMPLETE)


def _exit_code(search: Engine[Search], otherwise: ExitCode) -> ExitCode:
    """What ended the search before its end, or the code of its result."""
    if search.exhausted:
        return otherwise
    if search.interrupted:
        return ExitCode.INTERRUPTED
    return ExitCode.INFRA if search.stopped else otherwise


def _next_lines(found: RareEstimate, search: Engine[Search]) -> Sequence[str]:
    """Why it ended, and the next useful command."""
    out = search.options.out
    why = 'interrupted' if search.interrupted else search.stopped
    lines = [f'ended: {why}'] if why else []
    failed = [row for row in search.rows if row.outcome is Outcome.FAIL]
    if search.interrupted or (search.stopped and not search.exhausted):
        lines.append('next: the same command with --resume continues it')
    elif found.state is State.UNCLEAR:
        more = '' if found.plain else (
            '--resume with more --runs adds islands to the same draws, for the lower end, and '
            'keeps the 95 %; '
        )
        lines.append(
            f'next: {more}a new estimate with more --runs narrows both ends, but is another look: '
            'tell both, as each misses in up to 5 %'
        )
    elif failed:
        worst = min(failed, key=lambda row: row.headline.upper if row.headline else 0.0)
        lines.append(
            f'next: taxinet analyze {shlex.quote(str(out))} for causes, or taxinet explain '
            f'{shlex.quote(str(out / worst.run_id))} for the worst failure'
        )
    else:
        lines.append(f'next: taxinet analyze {shlex.quote(str(out))}')
    return lines
