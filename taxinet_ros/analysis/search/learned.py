"""Output of a search's learned distribution: as JSON, as a program, as a picture."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.campaign.learned_program import learned_program
from taxinet_ros.campaign.learned_result import LEARNED_NAME, Evidence, LearnedResult
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.scenes.programs import find_program
from taxinet_ros.campaign.search import Search
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically

PROGRAM_NAME, PICTURE_NAME = 'learned.scenic', 'learned.png'


def write_learned(search: Search) -> list[str]:
    """Write ``learned.json``, ``learned.png`` and, if Scenic can express it, a program.

    Args:
        search: ended search whose Scenic child still runs.

    Returns:
        Lines to print: the files written, or why there are none; empty if the sampler never learns.
    """
    probabilities = search.learned()
    if not probabilities:
        return []
    if why := _nothing_learned(search, probabilities):
        return [f'nothing learned: {why}']
    from taxinet_ros.analysis.search.learned_picture import learned_picture

    out = search.options.campaign.out
    write_atomically(out / LEARNED_NAME, _result(search, probabilities).to_json())
    learned_picture(search.space.searched, probabilities, out / PICTURE_NAME, _title(search))
    names, notes = [LEARNED_NAME, PICTURE_NAME], []
    try:
        text, left = learned_program(
            find_program(search.options.campaign.program), search.space, probabilities,
            _title(search) + '.',
        )
        write_atomically(out / PROGRAM_NAME, text)
        names.append(PROGRAM_NAME)
        notes = [f'in {PROGRAM_NAME} as the program has it: {why}' for why in left]
    except UsageError as error:
        notes = [f'as a program: {error}']
    return [f'learned: {out / names[0]}, {", ".join(names[1:])}', *_evidence_words(search), *notes]


def _nothing_learned(search: Search, probabilities: Probabilities) -> str:
    """Reason why there is nothing to write; empty if there is something."""
    failures = sum(row.outcome is Outcome.FAIL for row in search.rows)
    judged = sum(row.outcome.judged for row in search.rows)
    if not failures:
        return f'none of {judged} judged runs failed'
    priors = {choice.dimension.name: choice.dimension.prior for choice in search.space.searched}
    if all(probabilities[name] == priors[name] for name in probabilities):
        return (
            f'after {judged} judged runs {search.options.sampler} still draws as the program does; '
            'ask for more --runs'
        )
    return ''


def _evidence_words(search: Search) -> list[str]:
    """Display text of the evidence for the learned histograms."""
    evidence = _evidence(search)
    if not evidence:
        return []
    most = max(evidence.values(), key=lambda each: sum(each.amounts))
    return [
        f'learned from failures worth {most.failures:.0f} drawn by the program itself, and drawn '
        'towards the program where they are few; several seeds together have intervals '
        '(taxinet learned)'
    ]


def _evidence(search: Search) -> dict[str, Evidence]:
    """Weighted failures by bin of each dimension; empty if the runs' weights are not known."""
    failed = [row for row in search.rows if row.outcome is Outcome.FAIL]
    found = {}
    for choice in search.space.searched:
        name = choice.dimension.name
        amounts, squares = [0.0] * len(choice.dimension.prior), 0.0
        for row in failed:
            if row.weight is None:
                return {}
            if name in row.point:
                amounts[choice.dimension.bin(row.point[name])] += row.weight
                squares += row.weight**2
        found[name] = Evidence(amounts=tuple(amounts), squares=squares)
    return found


def _title(search: Search) -> str:
    options = search.options
    program = Path(options.campaign.program).stem
    return (
        f'Failures of {search.perception} on {program}, found by {options.sampler} in '
        f'{len(search.rows)} runs'
    )


def _result(search: Search, probabilities: Probabilities) -> LearnedResult:
    return LearnedResult(
        facts={**search.book.facts, 'perception': search.perception, 'runs_made': len(search.rows)},
        choices=tuple(
            choice for choice in search.space.searched if choice.dimension.name in probabilities
        ),
        probabilities=probabilities, evidence=_evidence(search),
    )
