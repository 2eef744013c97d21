"""Output of a search's learned distribution: as JSON and as a program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.samplers.registry import check_sampler
from taxinet_ros.samplers.sampler import Probabilities
from taxinet_ros.scenes.overrides import overrides_statement
from taxinet_ros.scenes.programs import find_program, write_program
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.learned_program import learned_program
from taxinet_ros.trials.learned_result import LEARNED_NAME, Evidence, LearnedResult
from taxinet_ros.trials.search import Search

PROGRAM_NAME = 'learned.scenic'


def write_learned(search: Engine[Search]) -> list[str]:
    """Write ``learned.json`` and, if Scenic can express it, a program.

    Args:
        search: ended search whose Scenic child still runs.

    Returns:
        Lines to print: the files written, or why there are none; empty if the sampler never learns.
    """
    probabilities = search.proposer.learned()
    if not probabilities:
        return []
    if why := _nothing_learned(search, probabilities):
        return [f'nothing learned: {why}']
    out = search.options.out
    write_atomically(out / LEARNED_NAME, _result(search, probabilities).to_json())
    space = search.proposer.space
    programs: list[str] = []
    try:
        text, left = learned_program(
            find_program(search.options.program), space, probabilities,
            _title(search) + '.',
        )
        given = {**search.options.overrides, **search.options.laid_over}
        write_program(
            out / PROGRAM_NAME, '\n'.join([text, overrides_statement(given)]).rstrip() + '\n',
            str(search.book.facts['program_text']),
        )
        programs = [PROGRAM_NAME]
        notes = [f'in {PROGRAM_NAME} as the program has it: {why}' for why in left]
    except UsageError as error:
        notes = [f'as a program: {error}']
    files = ', '.join([str(out / LEARNED_NAME), *programs])
    return [f'learned: {files}', *_evidence_words(search), *notes]


def _nothing_learned(search: Engine[Search], probabilities: Probabilities) -> str:
    """Reason why there is nothing to write; empty if there is something."""
    judged = search.summary.judged
    if not search.summary.outcomes[Outcome.FAIL]:
        return f'none of {judged} judged runs failed'
    searched = search.proposer.space.searched
    priors = {choice.dimension.name: choice.dimension.prior for choice in searched}
    if all(probabilities[name] == priors[name] for name in probabilities):
        return (
            f'after {judged} judged runs {search.proposer.sampler} still draws as the '
            'program does; ask for more runs'
        )
    return ''


def _evidence_words(search: Engine[Search]) -> list[str]:
    """Display text of the evidence for the learned histograms."""
    evidence = _evidence(search)
    if not evidence:
        return []
    most = max(evidence.values(), key=lambda each: sum(each.amounts))
    return [
        f'learned from failures worth {most.failures:.0f} drawn by the program itself, and drawn '
        'towards the program where they are few'
    ]


def _evidence(search: Engine[Search]) -> dict[str, Evidence]:
    """Weighted failures by bin of each dimension; empty if the runs' weights are not known.

    Of runs whose first point met the requirements: their weights are right up to one factor, the
    probability that a point of the program meets them. Those of later points are unknown.
    """
    failed = [row for row in search.rows if row.outcome is Outcome.FAIL]
    soft = search.proposer.space.soft
    if any(row.weight is None and (soft or not row.refused) for row in failed):
        return {}
    weighted = [(row.point, row.weight) for row in failed if row.weight and not row.refused]
    heaviest = _heaviest(search, [weight for _, weight in weighted])
    found = {}
    for choice in search.proposer.space.searched:
        name, bins = choice.dimension.name, len(choice.dimension.prior)
        places = [choice.dimension.bin(point[name]) for point, _ in weighted if name in point]
        weights = np.array([weight for point, weight in weighted if name in point])
        found[name] = Evidence(
            amounts=tuple(np.bincount(places, weights, bins).tolist()),
            squares=tuple(np.bincount(places, weights**2, bins).tolist()), heaviest=heaviest,
        )
    return found


def _heaviest(search: Engine[Search], weights: Sequence[float]) -> float | None:
    """The greatest weight that a run can have, from the share that the program itself draws.

    None without such a share, and for a package's sampler that does not say it as ``floor``.
    """
    options = search.proposer
    floor = check_sampler(options.sampler, options.sampler_options).get('floor', 0.0)
    return max(1 / floor, *weights) if floor else None


def _title(search: Engine[Search]) -> str:
    program, sampler = Path(search.options.program).stem, search.proposer.sampler
    return (
        f'Failures of {search.perception} on {program}, found by {sampler} in '
        f'{len(search.rows)} runs'
    )


def _result(search: Engine[Search], probabilities: Probabilities) -> LearnedResult:
    return LearnedResult(
        facts={**search.book.facts, 'perception': search.perception, 'runs_made': len(search.rows)},
        choices=tuple(
            choice for choice in search.proposer.space.searched
            if choice.dimension.name in probabilities
        ),
        probabilities=probabilities, evidence=_evidence(search),
    )
