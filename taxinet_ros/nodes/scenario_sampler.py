"""Executable ``scenario_sampler``: run a campaign or a search on a running graph.

Its parameters are the options of ``taxinet run`` and ``taxinet falsify``. It runs the scenes on the
graph one by one and writes the table.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.search.learned import write_learned
from taxinet_ros.core.verdict.judging import StopOn
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import BESIDE, PARTICIPANTS
from taxinet_ros.nodes.lockstep.sampler import PATIENCE
from taxinet_ros.nodes.lockstep.standing_sampler import StandingSampler
from taxinet_ros.nodes.names import check_participants
from taxinet_ros.nodes.running.node_main import complain, run_node
from taxinet_ros.nodes.running.parameters import (
    Parameter,
    Usage,
    declare_all,
    published_topics,
    refuse_unknown,
)
from taxinet_ros.processes.interrupts import interrupts
from taxinet_ros.samplers.registry import SAMPLERS
from taxinet_ros.trials.campaign import ProgramOrder, exit_code
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.options import CampaignOptions, make_options
from taxinet_ros.trials.requirements import DEFAULT_SPECS
from taxinet_ros.trials.search import Search, make_search
from taxinet_ros.trials.search_summary import heading_lines, search_summary
from taxinet_ros.trials.stress import likeliest_failure
from taxinet_ros.trials.summary import (
    campaign_heading,
    campaign_summary,
    requirement_lines,
    row_line,
)

_PROGRAMS = 'program'
"""Word that selects the program's own sampler, else the default."""
_RUNS, _RUNS_OF_A_SEARCH = 1, 100
"""Default numbers of runs, as in ``taxinet run`` and ``taxinet falsify``."""
_OPTIONS = (
    Parameter(
        name='participants', default=list(PARTICIPANTS), takes=', '.join((*PARTICIPANTS, *BESIDE)),
        description='nodes of the lockstep, without the simulator',
    ),
    Parameter(
        name='program', default='s_falsif', takes='a shipped word or a .scenic file',
        description='Scenic program that the scenes are drawn from',
    ),
    Parameter(
        name='runs', default=0, limits=(0, 1_000_000),
        description=f'number of scenes; 0: {_RUNS}, or with a sampler {_RUNS_OF_A_SEARCH}',
    ),
    Parameter(
        name='seed', default=0, limits=(0, 2**31 - 1), description='seed of the scenes',
    ),
    Parameter(
        name='set', default=[''], takes='KEY=VALUE each, as in taxinet run --set',
        description='scenario values that replace drawn ones',
    ),
    Parameter(
        name='specs', default=list(DEFAULT_SPECS),
        takes='names of shipped formulas, NAME=FORMULA, or YAML files',
        description='formulas to evaluate; the first is the headline',
    ),
    Parameter(
        name='out', default='', takes='a folder, or empty',
        description='folder of the table; empty: one below bags/',
    ),
    Parameter(
        name='stop_on', default=str(StopOn.NEVER), words=tuple(map(str, StopOn)),
        description='when to end a run before its end',
    ),
    Parameter(
        name='bounds', default=[''], takes='SIGNAL=LOW:HIGH each, e.g. cte=-25:25',
        description='assumed ranges of signals',
    ),
    Parameter(
        name='rates', default=[''], takes='SIGNAL=CHANGE per second each, e.g. cte=3',
        description='assumed maximum rates of change',
    ),
    Parameter(
        name='sampler', default='', takes=f'{_PROGRAMS}, {", ".join(SAMPLERS)}, or empty',
        description='how scenes are chosen, as in taxinet falsify; program: as the program says; '
        'empty: as taxinet run',
    ),
    Parameter(
        name='sampler_options', default=[''], takes='KEY=VALUE each',
        description='options of the sampler',
    ),
    Parameter(
        name='resume', default=False, description='continue an interrupted campaign in out',
    ),
    Parameter(
        name='until', default='', takes='a rule of taxinet falsify --until, or empty',
        description='stop a search early',
    ),
    Parameter(
        name='budget', default=0.0, limits=(0.0, 1e6),
        description='time budget: a search starts no new run after this [min]; 0: unlimited',
    ),
)
_WHAT = ('program', 'runs', 'seed', 'specs', 'stop_on', 'bounds', 'rates')
_HOW = ('sampler_options', 'resume', 'until', 'budget')
USAGE = Usage(
    executable=interface.SCENARIO_SAMPLER,
    does='Runs a campaign or a search on a running graph and writes its table; options as in '
    'taxinet run and taxinet falsify.',
    publishes=published_topics(interface.SCENARIO_SAMPLER),
    subscribes=(interface.NODE_STATUS.name, interface.OBITUARY.name),
    other=f'client of the action {interface.RUN_SCENARIO} (taxinet_msgs/action/RunScenario)',
    parameters=(*PATIENCE, *_OPTIONS),
    ends=('here 0: every run satisfied its formulas; 1: some run violated one',),
)


class StandaloneSampler(StandingSampler):
    """The sampler with the options of ``taxinet run`` and ``taxinet falsify`` as parameters.

    Attributes:
        campaign: campaign options.
        search: the search; None if the program draws the scenes.
    """

    def __init__(self, **node: Any) -> None:
        """Read the parameters; ``node`` goes to :class:`rclpy.node.Node`.

        Raises:
            UsageError: a parameter is invalid.
        """
        super().__init__(**node)
        given = declare_all(self, _OPTIONS)
        self.participants = tuple(given['participants'])
        check_participants(self.participants)
        sampler = given['sampler']
        how = {name: given[name] for name in _HOW}
        what = {name: given[name] for name in _WHAT}
        what['settings'] = given['set']
        what['out'] = Path(given['out']) if given['out'] else None
        refuse_unknown(self)
        if not sampler and any(how.values()):
            told = ', '.join(name for name, value in how.items() if value)
            raise UsageError(f'{told}: for a sampler only; known: {", ".join(SAMPLERS)}')
        what['runs'] = what['runs'] or (_RUNS_OF_A_SEARCH if sampler else _RUNS)
        self.campaign: CampaignOptions = make_options(
            **what, perception='', processes=True, resume=how['resume']
        )
        if self.campaign.gains:
            raise UsageError(
                f'steering.{next(iter(self.campaign.gains))}: the controller is already running; '
                'set gains as its parameters'
            )
        self.search: Search | None = make_search(
            self.campaign, sampler=None if sampler == _PROGRAMS else sampler,
            sampler_options=how['sampler_options'], until=how['until'] or None,
            budget_min=how['budget'] or None,
        ) if sampler else None

    def say(self, lines: Iterable[str]) -> None:
        """Print lines."""
        for line in lines:
            self.get_logger().info(line.rstrip())


def _work(node: StandaloneSampler, executor: Any) -> int:
    """Sample, run and tabulate as the parameters say."""
    # Needed to write the table; after Ctrl-C, ``ros2 launch`` waits only 5 s.
    for name in ('pandas', 'pyarrow.parquet'):
        importlib.import_module(name)
    search, learned = node.search, []
    proposer = search or ProgramOrder(node.campaign)
    engine: Engine[Any] = Engine(
        proposer, node.participants, lambda row: node.say([row_line(row).plain])
    )
    resuming = f'-p resume:=true -p out:={engine.options.out}'

    def interrupt() -> None:
        engine.interrupt()
        node.interrupt()

    with interrupts(interrupt), engine:
        if engine.book.warning:
            node.say([engine.book.warning])
        node.say([campaign_heading(node.campaign), *proposer.notes] if search is None
                 else heading_lines(search))
        node.say(line.plain for line in requirement_lines(proposer.check))
        trouble = node.drive(executor, engine)
        if search is not None:
            learned = write_learned(engine)
    found = engine.summary
    if search is not None and (found or engine.interrupted):
        likeliest = likeliest_failure(search.sampler, engine.rows)
        node.say([*search_summary(engine, likeliest, resuming), *learned])
    elif found:
        node.say(campaign_summary(found, node.campaign).splitlines())
    if trouble:
        more = '' if search is None else f'; continue with {resuming}'
        return complain(trouble + more, ExitCode.INFRA)
    if engine.interrupted and len(found) < engine.options.runs:
        return ExitCode.INTERRUPTED
    return exit_code(found)


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros scenario_sampler``."""
    run_node(StandaloneSampler, _work, usage=USAGE)

if __name__ == '__main__':
    main()
