"""Writes down where a search has found failures: as numbers, as a program, as a picture."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.bag.layout import write_atomically
from taxinet_ros.campaign.learned_program import learned_program
from taxinet_ros.campaign.learned_result import LEARNED_NAME, LearnedResult
from taxinet_ros.campaign.programs import find_program
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.search import Search
from taxinet_ros.core.errors import UsageError

PROGRAM_NAME, PICTURE_NAME = 'learned.scenic', 'learned.png'


def write_learned(search: Search) -> list[str]:
    """Write ``learned.json``, ``learned.png`` and, where it can be said in Scenic, a program.

    Args:
        search: that has ended, with its Scenic child still there.

    Returns:
        Lines to print; none where the sampler has no idea, or nothing to have it from.
    """
    probabilities = search.learned()
    if not probabilities or not any(row.outcome.judged for row in search.rows):
        return []
    from taxinet_ros.analysis.learned_picture import learned_picture

    out = search.options.campaign.out
    write_atomically(out / LEARNED_NAME, _result(search, probabilities).to_json())
    learned_picture(search.space.searched, probabilities, out / PICTURE_NAME, _title(search))
    names, why = [LEARNED_NAME, PICTURE_NAME], ''
    try:
        text = learned_program(
            find_program(search.options.campaign.program), search.space, probabilities,
            _title(search) + '.',
        )
        write_atomically(out / PROGRAM_NAME, text)
        names.append(PROGRAM_NAME)
    except UsageError as error:
        why = f'; as a program: {error}'
    return [f'learned: {out / names[0]}, {", ".join(names[1:])}{why}']


def _title(search: Search) -> str:
    options = search.options
    program = Path(options.campaign.program).stem
    return (
        f'Failures of {search.perception} on {program}, found by {options.sampler} in '
        f'{len(search.rows)} runs'
    )


def _result(search: Search, probabilities: Probabilities) -> LearnedResult:
    return LearnedResult(
        facts={**search.facts, 'perception': search.perception, 'runs_made': len(search.rows)},
        choices=tuple(
            choice for choice in search.space.searched if choice.dimension.name in probabilities
        ),
        probabilities=probabilities,
    )
