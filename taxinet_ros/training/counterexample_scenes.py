"""Scenes on the way of a campaign's failed runs: what the network saw when it went wrong.

A failed run starts somewhere, but the pictures that misled the network lie along its path. Training
on places of the path, with the truth for a label, is counterexample-guided data augmentation
(Dreossi et al., IJCAI 2018); since the network's own steering led there, it is dataset aggregation
as well (Ross et al., AISTATS 2011).
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.trace import read_trace
from taxinet_ros.campaign.counterexamples import FailedRuns, failed_runs, scenario_of_row
from taxinet_ros.campaign.facts import LEDGER_NAME
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.training.dataset import Progress, silent

SPREAD_M = 0.5
"""Standard deviation [m] of the places around the path, across it: neighbours a step apart look
alike, and the next network will take another path."""

SPREAD_RAD = math.radians(2.0)
"""Likewise of the heading [rad]."""

WIDEST_M = 14.0
"""Places further off than this are left out: an aircraft on the grass teaches nothing of use."""

STEEPEST_RAD = math.radians(60.0)

_Path = tuple[Scenario, NDArray[np.float64]]
"""The scene of a run, and along its way distance [m], cross-track [m] and heading error [rad]."""


def counterexample_scenes(
    folder: Path, count: int, seed: int, progress: Progress = silent
) -> list[Scenario]:
    """Scenes that start where failed runs have been, drawn evenly over runs and steps.

    Args:
        folder: of the campaign, with the runs' bags; their pictures are not needed.
        count: scenes, of which several may lie at one step if the runs are few.
        seed: of what is drawn.
        progress: told as ``runs`` after every bag.

    Raises:
        UsageError: no campaign, no failed run, or none whose bag can be read.
    """
    paths = _paths(failed_runs(folder), progress)
    rng = np.random.default_rng(seed)
    return [_scene(*paths[rng.integers(len(paths))], rng) for _ in range(count)]


def ledger_digest(folder: Path) -> str:
    """SHA-256 of a campaign's ledger, which names its runs and what came of them.

    Raises:
        UsageError: it cannot be read.
    """
    try:
        return hashlib.sha256((folder / LEDGER_NAME).read_bytes()).hexdigest()
    except OSError as error:
        raise UsageError(f'{folder / LEDGER_NAME}: {error.strerror}') from error


def _paths(failed: FailedRuns, progress: Progress) -> list[_Path]:
    found: list[_Path] = []
    for number, row in enumerate(failed.rows, 1):
        try:
            trace = read_trace(failed.folder / row.run_id)
        except (BagError, UsageError):
            continue  # a bag that was deleted or damaged leaves the others
        scene, _ = scenario_of_row(row, failed.folder, failed.facts)
        columns = np.stack([trace['x_m'], trace['cte_m'], trace['he_rad']], axis=1)
        way = columns.astype(np.float64)[_on_the_way(columns)]
        if len(way):
            found.append((scene, way))
        progress('runs', number, len(failed.rows))
    if not found:
        raise UsageError(
            f'{failed.folder}: no bag of its {len(failed.rows)} failed runs can be read; '
            'run the campaign again'
        )
    return found


def _on_the_way(columns: NDArray[np.generic]) -> NDArray[np.bool_]:
    distance, cte, heading = columns.astype(np.float64).T
    return (
        (distance >= 0) & (distance <= 2600)
        & (np.abs(cte) <= WIDEST_M) & (np.abs(heading) <= STEEPEST_RAD)
    )


def _scene(scene: Scenario, way: NDArray[np.float64], rng: np.random.Generator) -> Scenario:
    distance, cte, heading = way[rng.integers(len(way))]
    aside, turned = rng.normal(0, SPREAD_M), rng.normal(0, SPREAD_RAD)
    return dataclasses.replace(
        scene,
        distance_m=float(distance),
        cross_track_m=float(np.clip(cte + aside, -WIDEST_M, WIDEST_M)),
        heading_rad=float(heading + turned),
    )
