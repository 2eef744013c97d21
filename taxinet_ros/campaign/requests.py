"""Numbers, names and rows of a campaign's runs: the same for a plain campaign and a search."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

from taxinet_ros.campaign.facts import this_stack
from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.node_words import is_node_elsewhere
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S

_UNFIT = re.compile(r'^[.-]|[^A-Za-z0-9_.-]')


def run_name(options: CampaignOptions, index: int, attempt: int = 1) -> str:
    """Name of a run, and of its bag, whatever the program's file is called.

    On a graph that outlives the campaign it begins with the name of the campaign's folder, which no
    other one has, for all their bags are written to one place; and each attempt at a broken run
    has a name of its own, so that what a node still says of one is not taken for the next.
    """
    standing = options.standing_graph
    stem = options.out.name if standing else f'{_stem(options)}-s{options.seed}'
    name = f'{re.sub(_UNFIT, "_", stem)[:150]}-{index:05d}'
    return f'{name}.{attempt}' if attempt > 1 and standing else name


def run_request(
    options: CampaignOptions, index: int, scenario: Scenario, participants: Sequence[str]
) -> RunRequest:
    """What run ``index`` of a campaign asks of the graph."""
    return RunRequest(
        run_id=run_name(options, index), index=index, program=_stem(options), seed=options.seed,
        scenario=scenario, specs=options.specs, participants=tuple(participants),
        stop_on=options.stop_on, bounds=options.bounds, rates=options.rates,
    )


def finished_row(options: CampaignOptions, request: RunRequest, result: RunResult) -> RunRow:
    """The row of a run that the graph has answered."""
    # A verdict stands only where the recorder has closed the bag, wherever its folder is by now.
    recorded = result.outcome.judged or (options.out / request.run_id).is_dir()
    bag = request.run_id if recorded else ''
    sim_s = max(result.last_seq, 0) * CONTROL_PERIOD_NS / NS_PER_S
    perception = options.perception
    if not perception or is_node_elsewhere(perception):
        perception = result.perception or perception
    result = dataclasses.replace(result, timing=result.timing or options.timing.words)
    return RunRow.of_run(
        request, result, perception=perception, sim_s=sim_s, bag=bag, stack=this_stack()
    )


def rejected_row(options: CampaignOptions, index: int, detail: str) -> RunRow:
    """The row of a scene that the program's requirements refuse."""
    return RunRow(
        run_id=run_name(options, index), index=index, program=_stem(options), seed=options.seed,
        perception=options.perception, outcome=Outcome.REJECTED, detail=detail,
        stack=this_stack(),
    )


def _stem(options: CampaignOptions) -> str:
    return Path(options.program).stem
