"""The sampler node of a campaign of its own: what to do comes as ROS parameters."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from taxinet_msgs.msg import NodeStatus

from taxinet_ros.campaign.options import DEFAULT_SPECS, CampaignOptions, make_options
from taxinet_ros.campaign.samplers.make import SAMPLERS
from taxinet_ros.campaign.search_options import SearchOptions, make_search_options
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.stop_on import StopOn
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.names import check_participants
from taxinet_ros.nodes.parameters import Parameter, declare_all, refuse_unknown
from taxinet_ros.nodes.scenario_sampler import PATIENCE, ScenarioSampler
from taxinet_ros.nodes.usage import Usage, spoken

_PROGRAMS = 'program'
"""In place of a sampler's word: the one that the program names, else the default."""

_RUNS, _RUNS_OF_A_SEARCH = 1, 100
"""Numbers of runs where none is given: those of ``taxinet run`` and ``taxinet falsify``."""

_OPTIONS = (
    Parameter(
        name='participants', default=list(PARTICIPANTS), takes=', '.join(PARTICIPANTS),
        description='node names that take part in the lockstep beside the simulator',
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
        name='set', default=[''], takes='KEY=VALUE each, as --set of taxinet run',
        description='scenario values that replace what is drawn',
    ),
    Parameter(
        name='specs', default=list(DEFAULT_SPECS),
        takes='names of shipped formulas, NAME=FORMULA, or YAML files',
        description='formulas to judge by; the first is the headline',
    ),
    Parameter(
        name='out', default='', takes='a folder, or empty',
        description='folder of the table; one below bags/ that says so where empty',
    ),
    Parameter(
        name='stop_on', default=str(StopOn.NEVER), words=tuple(map(str, StopOn)),
        description='when to end a run before its end',
    ),
    Parameter(
        name='bounds', default=[''], takes='SIGNAL=LOW:HIGH each, e.g. cte=-25:25',
        description='vouched for: bounds of signals',
    ),
    Parameter(
        name='rates', default=[''], takes='SIGNAL=CHANGE per second each, e.g. cte=3',
        description='vouched for: how fast signals change',
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
        name='resume', default=False, description='continue what was interrupted in out',
    ),
    Parameter(
        name='until', default='', takes='failures=K, half-width=W or empty',
        description='a search stops early',
    ),
    Parameter(
        name='budget', default=0.0, limits=(0.0, 1e6),
        description='a search begins no run after so long [min]; 0: ever',
    ),
)
_WHAT = ('program', 'runs', 'seed', 'specs', 'stop_on', 'bounds', 'rates')
_HOW = ('sampler_options', 'resume', 'until', 'budget')

USAGE = Usage(
    executable=interface.SCENARIO_SAMPLER,
    does='Runs a campaign, or a search, on the graph that stands, and writes its table; the '
    'options are those of taxinet run and taxinet falsify.',
    publishes=spoken(interface.SCENARIO_SAMPLER),
    subscribes=(interface.OBITUARY.name,),
    other=f'asks for the action {interface.RUN_SCENARIO} (taxinet_msgs/action/RunScenario)',
    parameters=(*PATIENCE, *_OPTIONS),
    ends=('here 0: every run satisfied its formulas; 1: some run violated one',),
)


class StandaloneSampler(ScenarioSampler):
    """The sampler with the options of ``taxinet run`` and ``taxinet falsify`` as parameters.

    Attributes:
        participants: nodes that take part in the lockstep beside the simulator.
        campaign: scenes of which program, judged how, and where to.
        search: how a sampler chooses them; None where they are those that the program draws.
    """

    def __init__(self, **node: Any) -> None:
        """Read the parameters; ``node`` goes to :class:`rclpy.node.Node`.

        Raises:
            UsageError: one line on the first that is wrong.
        """
        super().__init__(**node)
        topic = interface.OBITUARY
        self.create_subscription(NodeStatus, topic.name, self._on_obituary, topic.qos)
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
                raise UsageError(f'--{told}: for a --sampler only; known: {", ".join(SAMPLERS)}')
            what['runs'] = what['runs'] or (_RUNS_OF_A_SEARCH if sampler else _RUNS)
            self.campaign: CampaignOptions = make_options(
                **what, perception='', processes=True, resume=how['resume']
            )
            if self.campaign.gains:
                raise UsageError(
                    f'--set steering.{next(iter(self.campaign.gains))}: the controller runs '
                    'already; gains are parameters of its own'
                )
            self.search: SearchOptions | None = make_search_options(
                self.campaign, sampler=None if sampler == _PROGRAMS else sampler, workers=1,
                resume=how['resume'],
                sampler_options=how['sampler_options'], until=how['until'] or None,
                budget_min=how['budget'] or None,
            ) if sampler else None

    def waits_for(self) -> list[str]:
        """The simulator, where it is not found: see :mod:`.waiting`."""
        asked = self._request is not None and not self._last_heard
        return [interface.SIMULATOR] if asked else []

    def rivals(self) -> int:
        """Number of other samplers that have been seen in this graph."""
        return self._in_graph().count(self.get_name()) - 1

    def absent(self) -> list[str]:
        """Participants that are not seen in this graph."""
        seen = self._in_graph()
        return [name for name in self.participants if name not in seen]

    def _on_obituary(self, notice: NodeStatus) -> None:
        """Who looks after the simulator's process knows at once that it is dead."""
        dead = (notice.state, notice.node) == (NodeStatus.DIED, interface.SIMULATOR)
        if dead and self._is_at(notice.run_id):
            self.mourn(notice.node, notice.detail)

    def _is_at(self, run_id: str) -> bool:
        return self._request is not None and self._request.run_id == run_id

    def _in_graph(self) -> list[str]:
        nodes = self.get_node_names_and_namespaces()
        return [name for name, namespace in nodes if namespace == self.get_namespace()]


@contextlib.contextmanager
def parameter_words() -> Iterator[None]:
    """Within the ``with``, a complaint about an option of ``taxinet`` names the parameter."""
    try:
        yield
    except UsageError as error:
        text = re.sub(r'(?<!\S)--(spec|bound|rate)(?=\b)', r'--\1s', str(error))
        raise UsageError(re.sub(r'(?<!\S)--(?=[a-z])', '', text)) from error
