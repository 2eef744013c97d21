"""Executable ``scenario_sampler``: run a campaign or a search on a running graph.

Its parameters are the options of ``taxinet run`` and ``taxinet falsify``. It runs the scenes on the
graph one by one and writes the table.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from taxinet_msgs.msg import NodeStatus

from taxinet_ros.analysis.search.learned import write_learned
from taxinet_ros.core.verdict.judging import StopOn
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import ExitCode, InfraKind, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import BESIDE, PARTICIPANTS
from taxinet_ros.nodes.lockstep.sampler import PATIENCE, ScenarioSampler
from taxinet_ros.nodes.names import check_participants
from taxinet_ros.nodes.running.domain import nodes_present
from taxinet_ros.nodes.running.node_main import complain, run_node, spin_until
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


_SETTLED_S, _RECORDER_S = 0.7, 3.0
"""Times before the first run [s]: since the recorder was found, and at most, without it."""


class StandaloneSampler(ScenarioSampler):
    """The sampler with the options of ``taxinet run`` and ``taxinet falsify`` as parameters.

    Attributes:
        participants: nodes of the lockstep, without the simulator.
        campaign: campaign options.
        search: the search; None if the program draws the scenes.
        bags: folder in which the recorder writes, as it says; '' if none did.
    """

    def __init__(self, **node: Any) -> None:
        """Read the parameters; ``node`` goes to :class:`rclpy.node.Node`.

        Raises:
            UsageError: a parameter is invalid.
        """
        super().__init__(**node)
        topic, status = interface.OBITUARY, interface.NODE_STATUS
        self.create_subscription(NodeStatus, topic.name, self._on_death_notice, topic.qos)
        self.create_subscription(NodeStatus, status.name, self._on_status, status.qos)
        self.bags = ''
        self._found_s = 0.0
        given = declare_all(self, _OPTIONS)
        self.participants = tuple(given['participants'])
        check_participants(self.participants)
        sampler = given['sampler']
        how = {name: given[name] for name in _HOW}
        what = {name: given[name] for name in _WHAT}
        what['settings'] = given['set']
        what['out'] = Path(given['out']) if given['out'] else None
        refuse_unknown(self)
        with parameter_words():
            if not sampler and any(how.values()):
                told = ', '.join(name for name, value in how.items() if value)
                raise UsageError(f'{told}: for a sampler only; known: {", ".join(SAMPLERS)}')
            what['runs'] = what['runs'] or (_RUNS_OF_A_SEARCH if sampler else _RUNS)
            self.campaign: CampaignOptions = make_options(
                **what, perception='', processes=True, resume=how['resume']
            )
            if self.campaign.gains:
                raise UsageError(
                    f'steering.{next(iter(self.campaign.gains))}: the controller is already '
                    'running; set gains as its parameters'
                )
            self.search: Search | None = make_search(
                self.campaign, sampler=None if sampler == _PROGRAMS else sampler,
                sampler_options=how['sampler_options'], until=how['until'] or None,
                budget_min=how['budget'] or None,
            ) if sampler else None

    def waits_for(self) -> list[str]:
        """The simulator, if not found; see :class:`.node_main.Waiting`."""
        asked = self._request is not None and not self._last_heard
        return [interface.SIMULATOR] if asked else []

    def _may_ask(self) -> bool:
        """Also let the recorder find this node: when it is ready, it says where the bags are."""
        if not super()._may_ask():
            return False
        if self.bags or interface.RECORDER not in self.participants:
            return True
        now = time.monotonic()
        ends = self.get_publishers_info_by_topic(interface.NODE_STATUS.name)
        if not self._found_s and interface.RECORDER in {end.node_name for end in ends}:
            self._found_s = now
        # This node has found the recorder a moment before the recorder has found this node.
        settled = self._found_s and now - self._found_s > _SETTLED_S
        return bool(settled) or now - self._asked > _RECORDER_S

    def drive(self, executor: Any, engine: Engine[Any]) -> str:
        """Make the runs of a campaign one by one; return why the graph is unusable, or ''."""
        if nodes_present(self).count(self.get_name()) > 1:
            return _RIVAL
        broken: set[int] = set()
        trouble = ''

        def take(request: RunRequest, result: RunResult) -> bool:
            nonlocal trouble
            # If the second attempt at a run finds no graph, the run may have broken it, so that is
            # its result.
            if result.outcome is Outcome.INFRA_ERROR and request.index not in broken:
                trouble = self._trouble(result)
                if trouble:
                    return False
                broken.add(request.index)
            recorded = interface.RECORDER in request.participants
            engine.take(request, replace(result, bags=self.bags if recorded else ''))
            return True

        spin_until(executor, self.start(executor, iter(engine.next, None), take))
        return trouble

    def say(self, lines: Iterable[str]) -> None:
        """Print lines."""
        for line in lines:
            self.get_logger().info(line.rstrip())

    def _trouble(self, result: RunResult) -> str:
        """Tell a graph that is unusable from a run that failed: why it is, or ''."""
        if result.kind == InfraKind.BUSY:
            # The simulator may have been found before the sampler that it works for.
            return _RIVAL if nodes_present(self).count(self.get_name()) > 1 else (
                "the simulator is busy with another client's run; wait for its end, or give each "
                'graph its own ROS_DOMAIN_ID'
            )
        if result.kind != InfraKind.NOT_READY:
            return ''
        if result.who == interface.SIMULATOR:
            near = 'the same ROS_DOMAIN_ID and discovery range'
            return f'simulator: {result.detail}; start it with {near}'
        seen = nodes_present(self)
        if absent := ', '.join(name for name in self.participants if name not in seen):
            return f'{absent}: not in the graph; start it, or correct the parameter participants'
        return f'{result.who}: {result.detail}; see their output'

    def _on_death_notice(self, notice: NodeStatus) -> None:
        """The supervisor of the simulator's process reports its death at once."""
        dead = (notice.state, notice.node) == (NodeStatus.DIED, interface.SIMULATOR)
        if dead and self._request is not None and self._request.run_id == notice.run_id:
            self.report_death(notice.node, notice.detail)

    def _on_status(self, status: NodeStatus) -> None:
        # A replay's has no folder.
        if (status.state, status.node) == (NodeStatus.READY, interface.RECORDER) and status.detail:
            self.bags = status.detail


@contextlib.contextmanager
def parameter_words() -> Iterator[None]:
    """Context in which errors about ``taxinet`` options name the parameter instead."""
    try:
        yield
    except UsageError as error:
        text = re.sub(r'(?<!\S)--(spec|bound|rate)(?=\b)', r'--\1s', str(error))
        raise UsageError(re.sub(r'(?<!\S)--(?=[a-z])', '', text)) from error


_RIVAL = (
    'another sampler drives this graph; end it first (a killed one disappears after about 20 s), '
    'or give each graph its own ROS_DOMAIN_ID'
)


def _work(node: StandaloneSampler, executor: Any) -> int:
    """Sample, run and tabulate as the parameters say."""
    # Needed to write the table; after Ctrl-C, ``ros2 launch`` waits only 5 s.
    for name in ('pandas', 'pyarrow.parquet'):
        importlib.import_module(name)
    with parameter_words():
        return _run(node, executor)


def _run(node: StandaloneSampler, executor: Any) -> int:
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
