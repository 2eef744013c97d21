"""Printed lines of a search: heading, choices of the sampler, and summary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.samplers.registry import check_sampler
from taxinet_ros.samplers.space import Branch
from taxinet_ros.scenes.search_space import SearchSpace
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.rates import failure_rate, off_runway_rate
from taxinet_ros.trials.search import COVERAGE, Search
from taxinet_ros.trials.sequential import FAILURES
from taxinet_ros.trials.stress import LikeliestFailure
from taxinet_ros.trials.summary import (
    ON_STANDING_GRAPH,
    participants_words,
    scene_words,
    workers_words,
    worst_words,
)


def _heading(search: Search) -> str:
    campaign = search.campaign
    verb = 'resuming' if campaign.resume else 'searching'
    graph = f'{participants_words(campaign)}, {workers_words(campaign)}'
    return (
        f'{verb} {campaign.program} for failures: up to {campaign.runs} runs, sampler '
        f'{search.sampler}, seed {campaign.seed}, '
        f'{ON_STANDING_GRAPH if campaign.standing_graph else graph} -> {campaign.out}'
    )


def heading_lines(search: Search) -> list[str]:
    """What is printed before the first run of an open search."""
    return [_heading(search), *space_lines(search.space), *search.notes]


def space_lines(space: SearchSpace) -> list[str]:
    """Lines on the choices that the sampler controls, with conditions, and on the others."""
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


def search_summary(
    search: Engine[Search], likeliest: LikeliestFailure | None = None, resuming: str = 'resuming',
) -> list[str]:
    """Summary lines: counts, rates with intervals, the worst run, path of the table.

    Args:
        search: a search that has ended.
        likeliest: its likeliest failure, if it searched by likelihood and there is one.
        resuming: what continues it, in the words of the command or node.
    """
    found, campaign = search.summary, search.options
    lines = [found.count_words() or 'no run ended']
    lines += [*_rate_lines(search), *found.stopped_words(), *found.refused_words()]
    lines += found.blind_words()
    if (worst := found.worst) is not None:
        lines.append(f'worst: run {worst.index}, {worst_words(worst)}: {scene_words(worst)}')
    lines += likeliest.words() if likeliest else []
    lines += [*_rule_lines(search), *_odd_lines(search), found.table_line(campaign)]
    lines += found.next_line(campaign)
    why = 'interrupted' if search.interrupted else search.stopped
    if why and len(found) < search.options.runs:
        how = '' if search.exhausted else f'; {resuming} continues it'
        lines.append(f'ended before its {search.options.runs} runs: {why}{how}')
    elif found.outcomes[Outcome.INFRA_ERROR]:
        lines.append(f'{resuming} tries the runs again that the bench broke')
    return lines


def _rate_lines(search: Engine[Search]) -> list[str]:
    found, planned = search.summary, search.first_planned
    if not found.judged:
        return []
    verdicts, speed = found.verdicts, found.speed
    failed, off = failure_rate(verdicts, planned), off_runway_rate(verdicts, planned)
    made = f'{found.outcomes[Outcome.FAIL]} of {found.judged} judged runs failed'
    if failed.rate is None:
        return [
            failed.why_not, f'{made}, {found.off_runway_words()}, median {speed:.1f}x real time',
        ]
    left = '' if off is None or off.rate is None else f', off the runway {off.rate.words()}'
    lines = [
        f'under the program itself: satisfied {failed.rate.other.words()}{left} '
        f'({failed.rests_on})',
        f'{made}, median {speed:.1f}x real time',
    ]
    stop = search.proposer.stop
    if stop is not None and stop.kind == FAILURES and search.stopped == stop.reached:
        lines.append('it ended with a failure, so the share of failures is too high on average; '
                     'the interval holds all the same')
    return lines


def _rule_lines(search: Engine[Search]) -> list[str]:
    """Which runs break each rule of the objective."""
    objective = search.proposer.objective
    lines = []
    for name in () if objective is None else objective.rules:
        broken = [row.index for row in search.rows
                  if row.outcome.judged and row.robustness[name].failed]
        named = ', '.join(map(str, broken[:_MOST_BROKEN]))
        more = ', …' if len(broken) > _MOST_BROKEN else ''
        lines.append(f'{name}: broken in {len(broken)} runs{f" ({named}{more})" if broken else ""}')
    return lines


_MOST_BROKEN = 10
_COMBINATIONS = {1: 'cells', 2: 'pairs of cells', 3: 'triples of cells'}
_MOST_UNSEEN = 5


def _odd_lines(search: Engine[Search]) -> list[str]:
    """What the judged runs cover of the ODD, and what the program was not seen to reach."""
    odd, covering = search.proposer.odd, search.proposer.covering
    if odd is None or covering is None:
        return []
    reach = covering.reach()
    strength = int(check_sampler(COVERAGE, search.proposer.sampler_options)['strength'])
    feasible = odd.feasible(strength)
    covered = {each: np.zeros(mask.shape, dtype=bool) for each, mask in feasible.items()}
    judged = [row for row in search.rows if row.outcome.judged]
    places = [odd.inside(row.scene) for row in judged]
    for place in places:
        if place is not None:
            for each, mask in covered.items():
                mask[tuple(place[one] for one in each)] = True
    done = sum(int((feasible[each] & mask).sum()) for each, mask in covered.items())
    outside = places.count(None)
    what = _COMBINATIONS[strength]
    lines = [
        f'ODD {odd.name}: {done:,} of {reach.wanted:,} {what} in a judged run'
        + (f'; {outside:,} judged runs outside' if outside else '')
    ]
    if reach.unseen:
        named = '; '.join(odd.words(*one) for one in reach.unseen[:_MOST_UNSEEN])
        more = len(reach.unseen) - _MOST_UNSEEN
        lines.append(
            f'not reached by the program in {reach.points:,} scenes looked at: '
            f'{len(reach.unseen):,} ({named}' + (f'; and {more:,} more)' if more > 0 else ')')
        )
    return lines
