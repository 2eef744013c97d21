"""Shrinking of a failed run: a campaign whose scenes :mod:`.algorithm` chooses.

Its folder is a campaign folder. The next run depends only on the results, so a resumed shrinking
takes those of earlier sessions by their scenes. Runs without a verdict are repeated under their old
numbers, so the table equals that of an uninterrupted one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.user_code import is_node_elsewhere
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.engine import Proposer, with_workers
from taxinet_ros.trials.options import (
    DEFAULT_ROOT,
    CampaignOptions,
    make_options,
    new_folder,
)
from taxinet_ros.trials.past_runs.judged_run import JudgedRun, find_run
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import facts_of_runs
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.shrink.algorithm import LEAST_ASKED, Point, ShrinkSearch
from taxinet_ros.trials.shrink.space import STEPS, ShrinkSpace, make_shrink_space

PROGRAM = 'shrink'
"""Program name of runs without a program, in run names and in the table."""


class Shrinking(Proposer):
    """Proposes the scenes that a failed run is shrunk with.

    Attributes:
        run: the failed run.
        space: the scenarios that may be run.
        headline: name of the formula that must stay violated.
        search: search state.
        judged: the judged run of each point asked for.
    """

    patience, runs = 1, None

    def __init__(self, run: JudgedRun, space: ShrinkSpace, campaign: CampaignOptions) -> None:
        """Create it; nothing is written.

        Args:
            run: the failed run.
            space: the scenarios that may be run.
            campaign: options of the runs; ``runs`` limits those of the search.
        """
        self.run, self.space, self.campaign = run, space, campaign
        self.headline = campaign.judging.headline
        self.source: AbstractContextManager[None] = contextlib.nullcontext()
        self.search = ShrinkSearch(
            [one.axis for one in space.moving], most=campaign.runs, rule=space.possible
        )
        self.judged: dict[Point, RunRow] = {}
        self._points: dict[int, Point] = {}
        self._numbers: dict[str, int] = {}
        self._broken_before: dict[str, int] = {}
        self._undone: list[int] = []
        self._next = 0

    def prepare(self) -> dict[str, Any]:
        """See :class:`.Proposer`."""
        space, perception = self.space, self.campaign.perception
        return facts_of_runs(self.campaign, {
            'program': PROGRAM,
            'shrinks': self.run.run_id,
            'original': space.original.to_human(),
            'nominal': space.nominal.to_human(),
            'parameters': [one.key for one in space.parameters],
            'steps': STEPS,
            'perception_sha256': check_perception(perception, graph=True),
        })

    def resume(self, content: CampaignContent) -> tuple[Mapping[int, RunRow], Mapping[str, Any]]:
        """See :class:`.Proposer`."""
        self._next = content.begun
        done = {row.index: row for row in content.rows if row.outcome.judged}
        self._numbers = {_key(row.scene): row.index for row in done.values()}
        self._undone = sorted(set(range(self._next)) - done.keys())
        self._broken_before = {
            _key(row.scene): row.retries + (row.outcome is Outcome.INFRA_ERROR)
            for row in content.rows if not row.outcome.judged
        }
        return done, {}

    def stop_reason(self) -> str:
        """See :class:`.Proposer`."""
        return self.search.state.end.value

    def propose(self) -> int | None:
        """See :class:`.Proposer`."""
        under_way = set(self._points.values()) - self.judged.keys()
        point = next((point for point in self.search.wanted if point not in under_way), None)
        if point is None:
            return None
        index = self._numbers.get(_key(self.space.scenario(point).to_human()))
        if index is None and self._undone:
            index = self._undone.pop(0)
        elif index is None:
            index, self._next = self._next, self._next + 1
        self._points[index] = point
        return index

    def scene(self, index: int) -> Scenario:
        """See :class:`.Proposer`."""
        return self.space.scenario(self._points[index])

    def completed(self, row: RunRow) -> RunRow:
        """See :class:`.Proposer`."""
        return row.with_choice(
            sampler=PROGRAM, point={}, weight=None,
            retries=self._broken_before.get(_key(row.scene), 0),
        )

    def take(self, row: RunRow) -> None:
        """See :class:`.Proposer`."""
        if row.outcome.judged:
            point = self._points[row.index]
            self.judged[point] = row
            self.search.tell(point, row.rho[self.headline])


def make_shrinking(
    path: Path, *, runs: int, out: Path | None, perception: str | None = None,
    controller: str | None = None, specs: Sequence[str] = (), nominal: Sequence[str] = (),
    images: str = 'none', resume: bool = False, workers: int = 1, cluster: str | None = None,
    **others: Any,
) -> Shrinking:
    """Check what a user asks for; what is not named here is as in :func:`.make_options`.

    Args:
        path: folder of the failed run.
        runs: maximum number of runs of the search.
        out: as there.
        perception: perception, if not the run's.
        controller: controller, if not the run's.
        specs: formulas as text; the run's if empty.
        nominal: ``key=value`` of the nominal scenario.
        images: record ``all`` or ``none`` of the camera frames.
        resume: as there.
        workers: see :func:`.with_workers`.
        cluster: likewise.
        others: engine and audit.

    Raises:
        UsageError: one line on the first error.
    """
    if runs < LEAST_ASKED:
        raise UsageError(f'--runs {runs}: needs to be {LEAST_ASKED} or more')
    run = find_run(path)
    _check_repeatable(path, run)
    _check_failed(path, run, other_specs=bool(specs))
    space = make_shrink_space(run.scenario, nominal)
    if out is None and not resume:
        out = new_folder(DEFAULT_ROOT / f'{PROGRAM}-{run.run_id}')
    campaign = make_options(
        program=PROGRAM, runs=runs, seed=run.seed, out=out, images=images, resume=resume,
        perception=_perception(run) if perception is None else perception,
        controller=controller or _controller(run), specs=specs or run.specs, world=run.world,
        **others,
    )
    gains = dict(run.gains) if campaign.controller == STEERING else {}
    campaign = dataclasses.replace(campaign, gains=gains, timing=run.timing)
    return Shrinking(run, space, with_workers(campaign, workers, cluster))


def _check_repeatable(path: Path, run: JudgedRun) -> None:
    why = f'a free run: {NOT_REPRODUCIBLE}' if run.timing.free else ''
    way_out = '; shrink a run that failed with --latency' if why else ''
    if not why:
        try:
            why = find_world(run.world, run.world_fingerprint).again_words
        except UsageError as error:
            raise UsageError(f'{run.run_id}: {error}') from error
    if why:
        raise UsageError(
            f'{path}: {why}, so nothing tells a scenario that matters from chance{way_out}'
        )


def _check_failed(path: Path, run: JudgedRun, *, other_specs: bool) -> None:
    if not run.outcome.judged:
        raise UsageError(f'{path}: {run.outcome}, so it was never judged; name a run that failed')
    if other_specs:
        return
    interval = run.robustness.get(run.headline)
    if interval is not None and interval.satisfied:
        raise UsageError(
            f'{path}: satisfied {run.headline} with {interval.words(".2f")}; name a run that '
            'failed, or with --spec what it failed'
        )


def _perception(run: JudgedRun) -> str:
    """The perception that failed."""
    try:
        now = check_perception(run.perception, graph=True)
    except UsageError as error:
        raise UsageError(f'{run.run_id}: {error}; say with --perception where it is') from error
    if now != run.fingerprint and not is_node_elsewhere(run.perception):
        raise UsageError(
            f'{run.run_id}: perception {run.perception} is {now[:12] or "without weights"} now, it '
            f'was {run.fingerprint[:12] or "without weights"}; --perception {run.perception} takes '
            'it as it is'
        )
    return run.perception


def _controller(run: JudgedRun) -> str:
    """Controller of the failed run."""
    try:
        now = check_controller(run.controller, graph=True)
    except UsageError as error:
        raise UsageError(
            f'{run.run_id}: {error}; say with --controller what to steer with'
        ) from error
    if now != run.controller_fingerprint and not is_node_elsewhere(run.controller):
        raise UsageError(
            f'{run.run_id}: controller {run.controller} is {now[:12]} now, it was '
            f'{run.controller_fingerprint[:12]}; --controller {run.controller} takes it as it is'
        )
    return run.controller


def _key(scene: Mapping[str, Any]) -> str:
    """Key of a scene in human units."""
    return json.dumps(scene)
