"""Looks at scenes for a sampler that wants them: closed loops with few pictures, in a child.

A look is made by a worker of its own, one after the other, without ROS, whatever makes the runs:
the loop is the graph's to the bit. It is not recorded: it is a function of scene, weights, seed and
number of the run, so a resumed search repeats it.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from taxinet_ros.campaign.loop_run import campaign_loop
from taxinet_ros.campaign.loop_worker import loop_worker_command
from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.record.facts import recorded_world
from taxinet_ros.campaign.samplers.screening import NAME
from taxinet_ros.campaign.worker_pool import WorkerPool
from taxinet_ros.core.perception.perception import GroundTruth
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.user_code import is_node_elsewhere
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError

PATIENCE = 3
"""Number of consecutive looks without a result that end the search."""
_POLL_S = 0.2


def check_can_look(campaign: CampaignOptions, cluster: str) -> None:
    """Check that scenes of a campaign can be looked at.

    Args:
        campaign: the campaign.
        cluster: the cluster that makes its runs, or ''.

    Raises:
        UsageError: looks would say nothing, or nothing about its runs.
    """
    def refuse(why: str) -> None:
        raise UsageError(f'--sampler {NAME}: {why}; use --sampler active')

    if campaign.standing_graph:
        refuse('looks at scenes with a perception of its own, not with that of a standing graph')
    for role, word in (('perception', campaign.perception), ('controller', campaign.controller)):
        if is_node_elsewhere(word):
            refuse(f'looks at scenes without nodes, and the {role} {word} is one')
    if campaign.perception == GroundTruth.word:
        refuse('a look spares pictures, and perception truth needs none')
    if campaign.timing.free:
        refuse('a look cannot tell how a --free run ends, which depends on real time')
    if again := find_world(campaign.world).again_words:
        refuse(f'{again}, so a look tells nothing about a run')
    if cluster:
        refuse('its looks are made on this machine, one by one, and would keep a --cluster waiting')


class Looker:
    """Looks at scenes. A context manager that ends its worker.

    Attributes:
        every: control steps from one picture to the next.
    """

    def __init__(
        self, campaign: CampaignOptions, facts: Callable[[], Mapping[str, Any]], every: int
    ) -> None:
        """Create it; nothing is started before the first look.

        Args:
            campaign: the campaign.
            facts: its recorded facts, once there are any.
            every: control steps from one picture to the next.
        """
        self.every = every
        self._campaign, self._facts = campaign, facts
        self._pool: WorkerPool | None = None
        self._opened = contextlib.ExitStack()
        self._broken = 0

    def __enter__(self) -> Self:
        """Open it."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the worker."""
        self._opened.__exit__(kind, error, trace)

    def look(self, index: int, scenario: Scenario) -> float | None:
        """Forecast of a scene's robustness; None if the look broke.

        Args:
            index: number of the run that may come of it.
            scenario: the scene.

        Raises:
            UsageError: parts that cannot be used for looks, or too many looks broke in a row.
        """
        campaign = self._campaign
        if self._pool is None:
            self._pool = self._opened.enter_context(self._started())
        self._pool.give(RunRequest(
            run_id=f'look-{index:05d}', index=index, program=campaign.program, seed=campaign.seed,
            scenario=scenario, judging=campaign.judging, participants=(),
        ))
        while not (answers := self._pool.answers(_POLL_S)):
            pass
        [(_, result)] = answers
        if result.outcome is Outcome.INFRA_ERROR:
            self._broken += 1
            if self._broken >= PATIENCE:
                raise UsageError(
                    f'--sampler {NAME}: {PATIENCE} looks in a row broke, the last by '
                    f'{result.who}: {result.detail}'
                )
            return None
        self._broken = 0
        interval = result.robustness.get(campaign.judging.headline)
        return None if interval is None else interval.nearest_to_zero

    def _started(self) -> WorkerPool:
        facts, campaign = self._facts(), self._campaign
        options = dataclasses.replace(
            campaign_loop(campaign, facts['controller_sha256'], recorded_world(facts)[1]),
            out=None, images='none', every=self.every,
        )
        logs = Path(campaign.out) / 'logs'
        logs.mkdir(exist_ok=True)
        return WorkerPool(loop_worker_command(options), 1, logs / 'looks')
