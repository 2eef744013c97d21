"""The files that go into a run's bag: the scene in the units people read, and the program."""

from __future__ import annotations

from pathlib import Path

from taxinet_msgs.msg import Scenario

from taxinet_ros.bag.message_values import scenario_json
from taxinet_ros.campaign.facts import read_facts
from taxinet_ros.campaign.programs import SUFFIX
from taxinet_ros.core.errors import UsageError


def run_attachments(scenario: Scenario, out: Path) -> dict[str, bytes]:
    """Files by name.

    A run of a campaign has the text of the Scenic program that its scene was drawn from, which
    stands in the campaign's folder; a run that somebody asked for by hand has none.

    Args:
        scenario: the run's.
        out: the folder that takes the bags.
    """
    files = {'scenario.json': scenario_json(scenario)}
    text = _program_text(scenario.program, out)
    if text:
        files[f'{scenario.program}{SUFFIX}'] = text.encode()
    return files


def _program_text(program: str, out: Path) -> str:
    """What the campaign's facts hold of a program, or ''; also where they are damaged."""
    try:
        facts = read_facts(out)
        if facts is not None and Path(facts.values['program']).stem == program:
            return str(facts.values['program_text'])
    except (UsageError, KeyError, TypeError):
        pass
    return ''
