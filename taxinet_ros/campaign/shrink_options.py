"""What shrinking a failed run is asked to do, checked before anything starts."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.campaign.judged_run import JudgedRun, find_run
from taxinet_ros.campaign.options import DEFAULT_ROOT, CampaignOptions, make_options, new_folder
from taxinet_ros.campaign.samplers.lagged import LAG
from taxinet_ros.campaign.shrink import LEAST_ASKED
from taxinet_ros.campaign.shrink_space import ShrinkSpace, make_space
from taxinet_ros.core.controller import STEERING, check_controller
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.node_words import is_node_elsewhere
from taxinet_ros.core.perception import check_perception
from taxinet_ros.core.timing import NOT_REPRODUCIBLE

PROGRAM = 'shrink'
"""Stands for the program of runs that come of no program, in their names and in the table."""


@dataclass(frozen=True, kw_only=True)
class ShrinkOptions:
    """One failed run to be shrunk.

    Attributes:
        run: the failed run.
        space: the scenarios that may be run.
        campaign: judged how, with which perception, and where to; ``runs`` is the most that the
            search may rest on.
        workers: graphs that run at once.
        resume: continue what was interrupted.
    """

    run: JudgedRun
    space: ShrinkSpace
    campaign: CampaignOptions
    workers: int = 1
    resume: bool = False

    @property
    def headline(self) -> str:
        """Name of the formula that has to stay violated."""
        return parse_spec(self.campaign.specs[0]).name


def make_shrink_options(
    path: Path, *, perception: str | None, specs: Sequence[str], nominal: Sequence[str], runs: int,
    workers: int, out: Path | None, resume: bool, images: str, controller: str | None = None,
) -> ShrinkOptions:
    """Check what a person typed.

    Args:
        path: folder of the failed run.
        perception: where not that of the run.
        specs: formulas as text; the run's where empty.
        nominal: ``key=value`` of the nominal scenario.
        runs: most runs that the search may rest on.
        workers: graphs that run at once.
        out: folder; where None, a new one below ``bags/`` that says what it holds.
        resume: ``out`` holds a shrinking that is to be continued.
        images: ``all`` or ``none`` of the camera frames go into the bags.
        controller: where not that of the run.

    Raises:
        UsageError: one line on the first thing that is wrong.
    """
    if not 1 <= workers <= LAG:
        raise UsageError(f'--workers {workers}: needs to be within 1..{LAG}')
    if runs < LEAST_ASKED:
        raise UsageError(f'--runs {runs}: needs to be {LEAST_ASKED} or more')
    run = find_run(path)
    if run.timing.free:
        raise UsageError(
            f'{path}: a free run: {NOT_REPRODUCIBLE}, so nothing tells a scenario that matters '
            'from chance; shrink a run that failed with --latency'
        )
    _check_failed(path, run, other_specs=bool(specs))
    space = make_space(run.scenario, nominal)
    if out is None and not resume:
        out = new_folder(DEFAULT_ROOT / f'{PROGRAM}-{run.run_id}')
    campaign = make_options(
        program=PROGRAM, runs=runs, seed=run.seed, perception=_perception(run, perception),
        controller=controller or _controller(run), settings=(), specs=specs or run.specs, out=out,
        processes=False, images=images, resume=resume,
    )
    gains = dict(run.gains) if campaign.controller == STEERING else {}
    return ShrinkOptions(
        run=run, space=space,
        campaign=dataclasses.replace(campaign, gains=gains, timing=run.timing),
        workers=workers, resume=resume,
    )


def _check_failed(path: Path, run: JudgedRun, *, other_specs: bool) -> None:
    if not run.outcome.judged:
        raise UsageError(f'{path}: {run.outcome}, so it was never judged; name a run that failed')
    if other_specs:
        return
    rho = run.rho.get(run.headline, 0.0)
    if rho > 0:
        raise UsageError(
            f'{path}: satisfied {run.headline} with rho {rho:+.2f}; name a run that failed, or '
            'with --spec what it failed'
        )


def _perception(run: JudgedRun, asked: str | None) -> str:
    """The perception to shrink with: the one that failed, unless another is asked for."""
    if asked is not None:
        return asked
    try:
        now = check_perception(run.perception, graph=True)
    except UsageError as error:
        raise UsageError(f'{run.run_id}: {error}; say with --perception where it is') from error
    if is_node_elsewhere(run.perception):
        return run.perception
    if now != run.fingerprint:
        raise UsageError(
            f'{run.run_id}: perception {run.perception} is {now[:12] or "without weights"} now, it '
            f'was {run.fingerprint[:12] or "without weights"}; --perception {run.perception} takes '
            'it as it is'
        )
    return run.perception


def _controller(run: JudgedRun) -> str:
    """What steered when it failed."""
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
