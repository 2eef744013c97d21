"""The sampler as a program: a campaign from ROS parameters, on a graph that runs already."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from taxinet_ros.campaign.campaign import Campaign, exit_code
from taxinet_ros.campaign.options import DEFAULT_SPECS, CampaignOptions, make_options
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.main import run_node
from taxinet_ros.nodes.parameters import declare, refuse_unknown
from taxinet_ros.nodes.scenario_sampler import ScenarioSampler
from taxinet_ros.nodes.spinning import spin_until


def run_standalone() -> None:
    """Sample, run and tabulate as the parameters say, then exit."""
    run_node(_CampaignNode, _work)


class _CampaignNode(ScenarioSampler):
    """The sampler with the campaign's options as parameters."""

    def __init__(self) -> None:
        super().__init__()
        text = 'Scenic program: a shipped word such as s_falsif, or a .scenic file'
        program = declare(self, 'program', 's_falsif', text)
        runs = declare(self, 'runs', 1, 'number of scenes', (1, 1_000_000))
        seed = declare(self, 'seed', 0, 'seed of the scenes', (0, 2**31 - 1))
        text = 'scenario values that replace what is drawn, key=value'
        settings = declare(self, 'set', [''], text)
        specs = declare(self, 'specs', list(DEFAULT_SPECS), 'formulas to judge by')
        text = 'folder of the table, which must be new; one below bags/ that says so where empty'
        out = declare(self, 'out', '', text)
        text = 'node names that take part in the lockstep beside the simulator'
        self.participants = tuple(declare(self, 'participants', list(PARTICIPANTS), text))
        refuse_unknown(self)
        self.options: CampaignOptions = make_options(
            program=program, runs=runs, seed=seed, perception='',
            settings=[text for text in settings if text], specs=specs,
            out=Path(out) if out else None, processes=True,
        )


def _work(node: _CampaignNode, executor: Any) -> int:
    def show(row: RunRow) -> None:
        rho = ' '.join(f'{name} {value:+.3f}' for name, value in row.rho.items())
        why = ' '.join(word for word in (row.kind, row.who, row.detail) if word)
        node.get_logger().info(f'{row.run_id}: {row.outcome} {rho or why}')

    with Campaign(node.options, node.participants, show) as campaign:
        finished = node.start(executor, campaign.requests(), campaign.take)
        whole = spin_until(executor, finished)
    return exit_code(campaign.rows) if whole else 4
