"""The arms of a confirmation experiment as searches: the same scenes, but for what is laid over."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from taxinet_ros.campaign.experiment_file import Arm, Experiment
from taxinet_ros.campaign.facts import LEDGER_NAME
from taxinet_ros.campaign.ledger import read_ledger
from taxinet_ros.campaign.options import CampaignOptions, check_new
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.samplers.lagged import LAG
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.perception import check_perception
from taxinet_ros.core.scenario import HUMAN_KEYS

PAIRS_NAME, JSON_NAME, PAGE_NAME = 'pairs.parquet', 'experiment.json', 'experiment.html'
"""What lies beside the arms once all have had their runs; the second vouches for the rest."""


def of_network(experiment: Experiment, perception: str) -> Experiment:
    """The experiment with another network in all its arms.

    Args:
        experiment: the experiment.
        perception: word or file.

    Raises:
        UsageError: there is no such network, or it is the network that the arms differ in.
    """
    check_perception(perception, graph=True)
    if len({arm.perception for arm in experiment.arms}) > 1:
        raise UsageError(
            f'--perception {perception}: the arms of {experiment.name} differ in their network; '
            'leave the option out'
        )
    arms = tuple(dataclasses.replace(arm, perception=perception) for arm in experiment.arms)
    return dataclasses.replace(experiment, arms=arms)


def arm_searches(
    experiment: Experiment, out: Path, *, workers: int, resume: bool
) -> dict[str, SearchOptions]:
    """One search for each arm, in a folder of its own, by the arm's name.

    Args:
        experiment: what is to be done.
        out: folder of the experiment.
        workers: graphs that run at once.
        resume: continue what is there.

    Raises:
        UsageError: the folder cannot be used, or the number of workers.
    """
    if not 1 <= workers <= LAG:
        raise UsageError(f'--workers {workers}: needs to be within 1..{LAG}')
    if not resume:
        check_new(out)
    elif not _may_be_begun(experiment, out):
        raise UsageError(f'--resume: {out}: holds no arm of {experiment.name}; leave --resume out')
    return {
        arm.name: SearchOptions(
            campaign=_campaign(experiment, arm, out), sampler=experiment.sampler,
            sampler_options=experiment.sampler_options, workers=workers,
            resume=resume and (out / arm.name / LEDGER_NAME).is_file(),
        )
        for arm in experiment.arms
    }


def _may_be_begun(experiment: Experiment, out: Path) -> bool:
    """Whether a folder holds arms of the experiment, if only one that was just to be begun."""
    arms = {arm.name for arm in experiment.arms}
    there = {path.name for path in out.iterdir()} if out.is_dir() else set()
    return bool(there) and (
        there <= arms or any((out / name / LEDGER_NAME).is_file() for name in arms)
    )


def arm_rows(experiment: Experiment, out: Path) -> dict[str, tuple[RunRow, ...]]:
    """The runs of every arm, by its name, out of the ledgers."""
    return {
        arm.name: read_ledger(out / arm.name / LEDGER_NAME).rows for arm in experiment.arms
    }


def check_paired(
    experiment: Experiment, rows: Mapping[str, tuple[RunRow, ...]]
) -> None:
    """See that the arms had the same scenes but for what an arm lays over.

    Raises:
        UsageError: two scenes of the same number differ elsewhere, so comparing them says nothing.
    """
    first = experiment.compare_to
    base = {row.index: row for row in rows[first]}
    touched = {arm.name: set(arm.laid_over) for arm in experiment.arms}
    for arm in experiment.others:
        free = touched[first] | touched[arm.name]
        for row in rows[arm.name]:
            other = base.get(row.index)
            if other is None or not (row.clouds and other.clouds):
                continue  # no scene was drawn, or not yet
            for key in HUMAN_KEYS:
                if key not in free and getattr(row, key) != getattr(other, key):
                    raise UsageError(
                        f'experiment {experiment.name}: run {row.index} has {key} '
                        f'{getattr(row, key)} in {arm.name} and {getattr(other, key)} in {first}, '
                        'though neither arm sets it; was the program changed between the arms?'
                    )


def _campaign(experiment: Experiment, arm: Arm, out: Path) -> CampaignOptions:
    return CampaignOptions(
        program=experiment.program, runs=experiment.runs, seed=experiment.seed,
        perception=arm.perception, out=out / arm.name, overrides=experiment.overrides,
        controller=arm.controller, laid_over=arm.laid_over, gains=arm.gains,
        specs=experiment.specs, images='none',
        arms=tuple(one.name for one in experiment.arms),
    )
