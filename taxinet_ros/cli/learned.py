"""Writes down where a search has found failures: as numbers, as a program, as a picture."""

from __future__ import annotations

import json
from pathlib import Path

from taxinet_ros.bag.layout import write_atomically
from taxinet_ros.campaign.learned_program import learned_program
from taxinet_ros.campaign.programs import find_program
from taxinet_ros.campaign.samplers.sampler import Probabilities
from taxinet_ros.campaign.search import Search
from taxinet_ros.core.errors import UsageError

JSON_NAME, PROGRAM_NAME, PICTURE_NAME = 'learned.json', 'learned.scenic', 'learned.png'


def write_learned(search: Search) -> list[str]:
    """Write ``learned.json``, ``learned.png`` and, where it can be said in Scenic, a program.

    Args:
        search: that has ended, with its Scenic child still there.

    Returns:
        Lines to print; none where the sampler has no idea.
    """
    probabilities = search.learned()
    if not probabilities:
        return []
    from taxinet_ros.analysis.learned_picture import learned_picture

    out = search.options.campaign.out
    write_atomically(out / JSON_NAME, _as_json(search, probabilities))
    learned_picture(search.space.searched, probabilities, out / PICTURE_NAME, _title(search))
    names, why = [JSON_NAME, PICTURE_NAME], ''
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
        f'Failures of {options.campaign.perception} on {program}, found by {options.sampler} in '
        f'{len(search.rows)} runs'
    )


def _as_json(search: Search, probabilities: Probabilities) -> str:
    dimensions = {
        choice.dimension.name: {
            'probabilities': list(probabilities[choice.dimension.name]),
            'prior': list(choice.dimension.prior),
            'quantiles': list(choice.dimension.edges),
            'options': [str(option) for option in choice.options],
        }
        for choice in search.space.searched if choice.dimension.name in probabilities
    }
    return json.dumps({'about': _title(search), 'dimensions': dimensions}, indent=2) + '\n'
