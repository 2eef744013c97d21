"""The lines that a search prints: what is searched, and what came of it."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from taxinet_ros.campaign.lines import (
    GRAPH_OF_OTHERS,
    blind_words,
    off_runway_words,
    refused_words,
    rho_words,
    scene_words,
    stopped_words,
    table_line,
    who_takes_part,
)
from taxinet_ros.campaign.outcome_words import count_outcomes
from taxinet_ros.campaign.rates import failure_rate, off_runway_rate
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.samplers.space import Branch
from taxinet_ros.campaign.search import Search
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.campaign.search_space import SearchSpace
from taxinet_ros.campaign.stop_rule import FAILURES
from taxinet_ros.core.outcome import Outcome


def search_heading(options: SearchOptions) -> str:
    """What is about to run."""
    campaign = options.campaign
    workers = '1 worker' if options.workers == 1 else f'{options.workers} workers'
    verb = 'resuming' if options.resume else 'searching'
    graph = f'{who_takes_part(campaign)}, {workers}'
    return (
        f'{verb} {campaign.program} for failures: up to {campaign.runs} runs, sampler '
        f'{options.sampler}, seed {campaign.seed}, '
        f'{GRAPH_OF_OTHERS if campaign.standing_graph else graph} -> {campaign.out}'
    )


def space_lines(space: SearchSpace) -> list[str]:
    """Which of a program's choices the sampler makes, and when, and which it leaves to chance."""
    options = {choice.dimension.name: choice.options for choice in space.searched}
    groups: dict[str, list[str]] = {}
    for choice in space.searched:
        where = ' or '.join(_branch_words(branch, options[branch.parent])
                            for branch in choice.dimension.when)
        groups.setdefault(f'where {where}: ' if where else '', []).append(choice.dimension.name)
    searched = '; '.join(f'{where}{", ".join(names)}' for where, names in groups.items())
    lines = [f'searched: {searched or "nothing"}']
    if space.unsearched:
        lines.append(f'drawn, not searched: {", ".join(space.unsearched)}')
    return lines


def _branch_words(branch: Branch, options: Sequence[object]) -> str:
    named = [str(options[number]) if options else f'option {number + 1}'
             for number in branch.categories]
    return f'{branch.parent} is {" or ".join(named)}'


def search_summary(search: Search, resuming: str = '--resume') -> list[str]:
    """What came of it: counts, rates with their intervals, the worst run, where the table is.

    Args:
        search: that has ended.
        resuming: what to add to the command to continue it.
    """
    rows, campaign = search.rows, search.options.campaign
    lines = [count_outcomes(rows) or 'no run ended']
    lines += [*_rate_lines(search), *stopped_words(rows), *refused_words(rows)]
    lines += [*blind_words(rows), *_worst(rows)]
    lines.append(table_line(rows, campaign))
    why = 'interrupted' if search.interrupted else search.stopped
    if why and len(rows) < campaign.runs:
        how = '' if search.exhausted else f'; {resuming} continues it'
        lines.append(f'ended before its {campaign.runs} runs: {why}{how}')
    elif any(row.outcome is Outcome.INFRA_ERROR for row in rows):
        lines.append(f'{resuming} tries the runs again that the bench broke')
    return lines


def _rate_lines(search: Search) -> list[str]:
    rows, planned = search.rows, search.first_planned
    judged = [row for row in rows if row.outcome.judged]
    if not judged:
        return []
    failed, off = failure_rate(rows, planned), off_runway_rate(rows, planned)
    speed = statistics.median(row.real_time_factor for row in judged)
    failures = sum(row.outcome is Outcome.FAIL for row in judged)
    made = f'{failures} of {len(judged)} judged runs failed'
    if failed.rate is None:
        return [
            failed.why_not, f'{made}, {off_runway_words(judged)}, median {speed:.1f}x real time',
        ]
    left = '' if off is None or off.rate is None else f', off the runway {off.rate.words()}'
    lines = [
        f'under the program itself: satisfied {failed.rate.other.words()}{left} '
        f'({failed.rests_on})',
        f'{made}, median {speed:.1f}x real time',
    ]
    stop = search.options.stop
    if stop is not None and stop.kind == FAILURES and search.stopped == stop.reached:
        lines.append('it ended with a failure, so the share of failures is too high on average; '
                     'the interval holds all the same')
    return lines


def _worst(rows: Sequence[RunRow]) -> list[str]:
    judged = [row for row in rows if row.outcome.judged]
    if not judged:
        return []
    worst = min(judged, key=lambda row: row.headline[::-1] if row.headline else ())
    return [f'worst: run {worst.index}, {rho_words(worst)}: {scene_words(worst)}']
