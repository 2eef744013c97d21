"""The lines that a search prints: what is searched, and what came of it."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from taxinet_ros.campaign.lines import (
    GRAPH_OF_OTHERS,
    off_runway_words,
    rho_words,
    scene_words,
    stopped_words,
    table_line,
)
from taxinet_ros.campaign.outcome_words import count_outcomes
from taxinet_ros.campaign.rates import Rate
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.samplers.estimate import Estimate
from taxinet_ros.campaign.samplers.space import Branch
from taxinet_ros.campaign.search import Search
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.campaign.search_space import SearchSpace
from taxinet_ros.campaign.stop_rule import failure_estimate, off_runway_estimate


def search_heading(options: SearchOptions) -> str:
    """What is about to run."""
    campaign = options.campaign
    workers = '1 worker' if options.workers == 1 else f'{options.workers} workers'
    verb = 'resuming' if options.resume else 'searching'
    graph = f'perception {campaign.perception}, {workers}'
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
    lines += [*_rate_lines(rows), *stopped_words(rows), *_worst(rows)]
    lines.append(table_line(rows, campaign))
    why = 'interrupted' if search.interrupted else search.stopped
    if why and len(rows) < campaign.runs:
        how = '' if search.exhausted else f'; {resuming} continues it'
        lines.append(f'ended before its {campaign.runs} runs: {why}{how}')
    return lines


def estimate_words(found: Estimate | None) -> str:
    """A rate with its interval in a few words; empty where none is known."""
    return _rate_words(found.rate) if found is not None and found.runs else ''


def _rate_lines(rows: Sequence[RunRow]) -> list[str]:
    judged = [row for row in rows if row.outcome.judged]
    if not judged:
        return []
    speed = statistics.median(row.real_time_factor for row in judged)
    failed, off = failure_estimate(rows), off_runway_estimate(rows)
    if failed is None:
        return [
            f'{off_runway_words(judged)}, median {speed:.1f}x real time; this sampler says nothing '
            'on how often the program fails'
        ]
    satisfied = Rate(1 - failed.rate.rate, 1 - failed.rate.high, 1 - failed.rate.low)
    drawn = all(row.weight == 1 for row in judged)
    worth = '' if drawn else f', weighted: worth {failed.effective:.0f} independent runs'
    left = '' if off is None else f', off the runway {_rate_words(off.rate)}'
    return [
        f'under the program itself: satisfied {_rate_words(satisfied)}{left} '
        f'(95 % intervals{worth})',
        f'{failed.failures} of {failed.runs} judged runs failed, median {speed:.1f}x real time',
    ]


def _rate_words(rate: Rate) -> str:
    return f'{rate.rate:.1%} [{rate.low:.1%}, {rate.high:.1%}]'


def _worst(rows: Sequence[RunRow]) -> list[str]:
    judged = [row for row in rows if row.outcome.judged]
    if not judged:
        return []
    worst = min(judged, key=lambda row: row.headline[::-1] if row.headline else ())
    return [f'worst: run {worst.index}, {rho_words(worst)}: {scene_words(worst)}']
