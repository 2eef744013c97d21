"""Calibrate the shipped monitor for a perception, on closed-loop runs of familiar scenes.

A first part of the satisfied runs says what pictures and estimates are usual, the others set the
thresholds; so the conformal guarantee of :mod:`taxinet_ros.core.assurance.monitor` holds for runs
of the same program with the same perception.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.assurance.checks import (
    CHECKS,
    Consistency,
    Familiar,
    Kinematics,
    features,
    fit_familiar,
)
from taxinet_ros.core.assurance.monitor import (
    SUFFIX,
    Calibration,
    RawChecks,
    Seen,
    conformal_threshold,
)
from taxinet_ros.core.control_step import rolling_on
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import Spec
from taxinet_ros.core.mtl.specs import parse_spec
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.verdict.judge import Judgement
from taxinet_ros.core.verdict.outcome import Outcome, outcome_of
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.training.data.dataset import draw_scenes

REQUIREMENT = 'phi_eventually'
"""A run counts as satisfied if it satisfies this."""
_EVERY = 5
"""Steps from one picture taken for the distribution to the next."""
_LEAST_FITTED = 5
_LEAST = 0.1
"""Least threshold: where paint is always found, all scores are 0."""
_T = TypeVar('_T')
_R = TypeVar('_R')
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrateOptions:
    """Options of a calibration.

    Attributes:
        perception: word or file.
        program: scenes that the perception is used to.
        runs: runs that set the thresholds; a quarter as many more say what is usual.
        rate: largest share of satisfied runs with an alarm.
        seed: seed of the scenes.
        workers: processes; same results.
        out: file to write.

    Raises:
        UsageError: a value is out of range, or the file cannot be written.
    """

    perception: str
    program: str
    runs: int
    rate: float
    seed: int
    workers: int
    out: Path

    def __post_init__(self) -> None:
        if not 0 < self.rate < 1:
            raise UsageError(f'--rate {self.rate:g}: expected a share between 0 and 1')
        if self.out.suffix != SUFFIX:
            raise UsageError(f'--out {self.out}: has to end in {SUFFIX}')
        if self.out.exists():
            raise UsageError(f'--out {self.out}: already exists; choose a new name')
        if not self.out.parent.is_dir():
            raise UsageError(f'--out {self.out}: {self.out.parent} is not a folder; make it first')

    @property
    def fitted(self) -> int:
        """Runs that say what is usual."""
        return max(self.runs // 4, _LEAST_FITTED)


def calibrate(options: CalibrateOptions, progress: Progress) -> Calibration:
    """Make the runs and write the calibration.

    Args:
        options: what to calibrate.
        progress: called with the stage, the runs done and their number.

    Raises:
        UsageError: there are too few satisfied runs for the rate, or a part cannot be used.
    """
    eyes = make_perception(options.perception)
    if not eyes.needs_image:
        raise UsageError(f'{options.perception}: sees no picture, so there is nothing to monitor')
    scenes = draw_scenes(
        options.program, seed=options.seed, images=options.fitted + options.runs
    )
    usual, others = scenes[:options.fitted], scenes[options.fitted:]
    work = options.perception, options.workers
    fitted = [one for one in _each(_usual_run, usual, work, 'usual', progress) if one is not None]
    if len(fitted) < _LEAST_FITTED:
        raise UsageError(
            f'only {len(fitted)} of {len(usual)} runs of {options.program} are satisfied; the '
            'monitor has to be calibrated where the perception is good'
        )
    familiar = fit_familiar(np.concatenate([one.pictures for one in fitted]))
    kinematics = fit_kinematics(np.concatenate([one.deviations for one in fitted]))
    # As in the file, so that the thresholds belong to what is read from it.
    familiar = Familiar(
        mean=familiar.mean, whitening=familiar.whitening.astype(np.float32).astype(np.float64)
    )
    largest = [
        one for one in _each(
            _largest, [(scene, familiar, kinematics) for scene in others], work, 'thresholds',
            progress,
        ) if one is not None
    ]
    each = options.rate / len(CHECKS)
    found = Calibration(
        perception=eyes.word, perception_sha256=eyes.fingerprint, program=options.program,
        seed=options.seed, runs=len(largest), rate=options.rate, familiar=familiar,
        kinematics=kinematics,
        thresholds={
            name: max(conformal_threshold([one[number] for one in largest], each), _LEAST)
            for number, name in enumerate(CHECKS)
        },
    )
    write_atomically(options.out, found.to_bytes())
    return found


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class UsualRun:
    """What a satisfied run says of the usual.

    Attributes:
        pictures: (n, features) of some of its pictures.
        deviations: (m, 3) as of :meth:`.Consistency.deviations`.
    """

    pictures: NDArray[np.float64]
    deviations: NDArray[np.float64]


def fit_kinematics(deviations: NDArray[np.float64]) -> Kinematics:
    """Turn per metre by least squares, and the spreads of what remains.

    A spread is the 95th percentile of the absolute deviation over 1.96, as of a normal one, since
    most steps go straight ahead and deviate hardly at all.

    Args:
        deviations: (m, 3) as of :meth:`.Consistency.deviations`.
    """
    cte_m, turned_rad, steered_m = deviations.T
    turn = float(turned_rad @ steered_m / max(float(steered_m @ steered_m), 1e-9))
    spreads = [
        max(float(np.quantile(np.abs(left), 0.95)) / 1.96, 1e-4)
        for left in (cte_m, turned_rad - turn * steered_m)
    ]
    return Kinematics(turn_per_m=turn, cte_spread_m=spreads[0], he_spread_rad=spreads[1])


def requirement() -> Spec:
    """The requirement that says which runs are satisfied."""
    return parse_spec(REQUIREMENT)


def drive_plainly(
    scene: Scenario, perception: Perception, on_step: Callable[[Step, TaxiCommand], None]
) -> Judgement:
    """Run a scene with the shipped law; each step comes with the command before it."""
    before = rolling_on(scene.speed_mps)

    def take(step: Step) -> None:
        nonlocal before
        on_step(step, before)
        before = step.command

    return run_closed_loop(scene, perception, specs=[requirement()], on_step=take)


def usual_run(scene: Scenario, perception: Perception) -> UsualRun | None:
    """Make a run and see what is usual in it; None if it is not satisfied."""
    pictures, deviations, consistency = [], [], Consistency()

    def take(step: Step, before: TaxiCommand) -> None:
        assert step.observation.image is not None
        if step.observation.seq % _EVERY == 0:
            pictures.append(features(step.observation.image))
        found = consistency.deviations(step.estimate, before) if step.estimate.usable else None
        if found is not None:
            deviations.append(found)

    judged = drive_plainly(scene, perception, take)
    if outcome_of(judged) is not Outcome.PASS or not deviations:
        return None
    return UsualRun(pictures=np.array(pictures), deviations=np.array(deviations))


def largest_scores(
    scene: Scenario, perception: Perception, familiar: Familiar, kinematics: Kinematics
) -> tuple[float, ...] | None:
    """Largest score of a run, by check; None if it is not satisfied."""
    checks = RawChecks(familiar, kinematics, scene)
    largest = [0.0] * len(CHECKS)

    def take(step: Step, before: TaxiCommand) -> None:
        assert step.observation.image is not None
        scores = checks.scores(
            Seen(image=step.observation.image, estimate=step.estimate, command=before)
        )
        for number, score in enumerate(scores or (float('inf'),) * len(CHECKS)):
            largest[number] = max(largest[number], score)

    judged = drive_plainly(scene, perception, take)
    return tuple(largest) if outcome_of(judged) is Outcome.PASS else None


_worker: list[Perception] = []
"""The perception of a worker process."""


def _start_worker(word: str) -> None:
    _worker.append(make_perception(word))


def _usual_run(scene: Scenario) -> UsualRun | None:
    return usual_run(scene, _worker[-1])


def _largest(given: tuple[Scenario, Familiar, Kinematics]) -> tuple[float, ...] | None:
    scene, familiar, kinematics = given
    return largest_scores(scene, _worker[-1], familiar, kinematics)


def _each(
    function: Callable[[_T], _R], items: Sequence[_T], work: tuple[str, int], stage: str,
    progress: Progress,
) -> Iterator[_R]:
    """Results in the order of the items, whatever the number of processes."""
    perception, workers = work
    if workers == 1:
        _start_worker(perception)
        for done, item in enumerate(items, 1):
            yield function(item)
            progress(stage, done, len(items))
        return
    with process_pool(workers, 'calibration worker', _start_worker, perception) as pool:
        for done, result in enumerate(pool.map(function, items, chunksize=4), 1):
            yield result
            progress(stage, done, len(items))
