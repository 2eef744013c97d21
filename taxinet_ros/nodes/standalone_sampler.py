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
from taxinet_ros.nodes.parameters import declare, refuse_unknown
from taxinet_ros.nodes.scenario_sampler import ScenarioSampler

_PROGRAMS = 'program'
"""In place of a sampler's word: the one that the program names, else the default."""

_RUNS, _RUNS_OF_A_SEARCH = 1, 100
"""Numbers of runs where none is given: those of ``taxinet run`` and ``taxinet falsify``."""


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
        text = 'node names that take part in the lockstep beside the simulator'
        self.participants = tuple(declare(self, 'participants', list(PARTICIPANTS), text))
        check_participants(self.participants)
        sampler, how = self._declare_search()
        what = self._declare_campaign()
        refuse_unknown(self)
        with parameter_words():
            if not sampler and any(how.values()):
                given = ', '.join(name for name, value in how.items() if value)
                raise UsageError(f'--{given}: for a --sampler only; known: {", ".join(SAMPLERS)}')
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

    def _declare_campaign(self) -> dict[str, Any]:
        text = 'Scenic program: a shipped word such as s_falsif, or a .scenic file'
        program = declare(self, 'program', 's_falsif', text)
        text = f'number of scenes; 0: {_RUNS}, or with a sampler {_RUNS_OF_A_SEARCH}'
        runs = declare(self, 'runs', 0, text, (0, 1_000_000))
        seed = declare(self, 'seed', 0, 'seed of the scenes', (0, 2**31 - 1))
        text = 'scenario values that replace what is drawn, key=value'
        settings = self._texts('set', text)
        specs = declare(self, 'specs', list(DEFAULT_SPECS), 'formulas to judge by')
        text = 'folder of the table; one below bags/ that says so where empty'
        out = declare(self, 'out', '', text)
        text = f'when to end a run before its end: {", ".join(StopOn)}'
        stop_on = declare(self, 'stop_on', str(StopOn.NEVER), text)
        bounds = self._texts('bounds', 'vouched for: SIGNAL=LOW:HIGH, e.g. cte=-25:25')
        rates = self._texts('rates', 'vouched for: SIGNAL=CHANGE per second, e.g. cte=3')
        return {
            'program': program, 'runs': runs, 'seed': seed, 'settings': settings, 'specs': specs,
            'out': Path(out) if out else None, 'stop_on': stop_on,
            'bounds': bounds, 'rates': rates,
        }

    def _declare_search(self) -> tuple[str, dict[str, Any]]:
        text = (
            'how scenes are chosen: ce, random, … as in taxinet falsify, or program for the one '
            'that the program names; empty: as taxinet run'
        )
        sampler = declare(self, 'sampler', '', text)
        return sampler, {
            'sampler_options': self._texts('sampler_options', 'of the sampler, key=value'),
            'resume': declare(self, 'resume', False, 'continue what was interrupted in out'),
            'until': declare(self, 'until', '', 'stop early: failures=K or half-width=W'),
            'budget': declare(self, 'budget', 0.0, 'begin no run after so long [min]; 0: ever',
                              (0.0, 1e6)),
        }

    def _texts(self, name: str, description: str) -> list[str]:
        # An empty list would have no type, so one empty text stands for none.
        return [text for text in declare(self, name, [''], description) if text]


@contextlib.contextmanager
def parameter_words() -> Iterator[None]:
    """Within the ``with``, a complaint about an option of ``taxinet`` names the parameter."""
    try:
        yield
    except UsageError as error:
        text = re.sub(r'(?<!\S)--(spec|bound|rate)(?=\b)', r'--\1s', str(error))
        raise UsageError(re.sub(r'(?<!\S)--(?=[a-z])', '', text)) from error
