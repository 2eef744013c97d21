"""Calibrate the shipped monitor for a perception, on closed-loop runs of familiar scenes.

A first part of the satisfied runs says what pictures and estimates are usual, the others set the
thresholds; so the conformal guarantee of :mod:`taxinet_ros.core.assurance.monitor` holds for runs
of the same program with the same perception.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.assurance.checks import (
    CHECKS,
    COMPONENTS,
    LEAST_RESPONSE_M2,
    LEAST_VARIANCE,
    RESPONSES,
    Consistency,
    Kinematics,
    Moves,
    Usual,
    check_usual_rate,
    features,
    fit_usual,
)
from taxinet_ros.core.assurance.monitor import (
    SUFFIX,
    Calibration,
    Fitted,
    RawChecks,
    Seen,
    conformal_rank,
    conformal_threshold,
    make_perceptions,
)
from taxinet_ros.core.control_step import rolling_on
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl.specs import parse_spec
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.verdict.outcome import Outcome, outcome_of
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.training.data.dataset import draw_scenes
from taxinet_ros.trials.rates import share_bounds

REQUIREMENT = 'phi_eventually'
"""A run counts as satisfied if it satisfies this."""
_EVERY = 5
"""Steps from one picture taken for the distribution to the next."""
_AT_FIRST = 50
"""Steps of the start, which bring the aircraft to the line; later all pictures are much alike."""
_EVERY_AT_FIRST = 2
_LEAST_FITTED = 5
_LEAST = 0.1
"""Least threshold: where paint is always found, all scores are 0."""
_T = TypeVar('_T')
_R = TypeVar('_R')
Progress = Callable[[str, int, int], None]


def calibrate(
    progress: Progress, *, program: str, perception: str, runs: int, rate: float, seed: int,
    workers: int, out: Path,
) -> Calibration:
    """Make the runs and write the calibration.

    Args:
        progress: called with the stage, the runs done and their number.
        program: scenes.
        perception: word or file.
        runs: runs that set the thresholds; a quarter as many more say what is usual.
        rate: largest share of satisfied runs with an alarm, on average over calibrations.
        seed: of the scenes.
        workers: processes; same results.
        out: file to write.

    Raises:
        UsageError: a value is out of range, the file cannot be written, there are too few satisfied
            runs for the rate, or a part cannot be used.
    """
    if not 0 < rate < 1:
        raise UsageError(f'rate {rate:g}: expected a share between 0 and 1')
    if out.suffix != SUFFIX:
        raise UsageError(f'out {out}: has to end in {SUFFIX}')
    if out.exists():
        raise UsageError(f'out {out}: already exists; choose a new name')
    if not out.parent.is_dir():
        raise UsageError(f'out {out}: {out.parent} is not a folder; make it first')
    eyes = make_perception(perception)
    if not eyes.needs_image:
        raise UsageError(f'{perception}: sees no picture, so there is nothing to monitor')
    few = max(runs // 4, _LEAST_FITTED)
    scenes = draw_scenes(program, seed=seed, images=few + runs)
    work = perception, workers
    found = _each(_usual_run, scenes[:few], work, 'usual', progress)
    usual = [one for one in found if one is not None]
    if len(usual) < _LEAST_FITTED:
        raise UsageError(
            f'only {len(usual)} of {few} runs of {program} are satisfied; the '
            'monitor has to be calibrated where the perception is good'
        )
    fitted = Fitted(
        familiar=_as_stored(fit_usual(
            np.concatenate([one.pictures for one in usual]), COMPONENTS, LEAST_VARIANCE
        )),
        kinematics=fit_kinematics(np.concatenate([one.deviations for one in usual])),
        moved=fit_usual(
            np.concatenate([one.responses for one in usual]), RESPONSES, LEAST_RESPONSE_M2
        ),
    )
    largest = [
        one for one in _each(
            _largest, [(scene, fitted) for scene in scenes[few:]], work,
            'thresholds', progress,
        ) if one is not None
    ]
    each = rate / len(CHECKS)
    made = Calibration(
        perception=eyes.word, perception_sha256=eyes.fingerprint, source=_source(perception),
        program=program, seed=seed, runs=len(largest), rate=rate,
        fitted=fitted, thresholds={
            name: max(conformal_threshold([float(one[number]) for one in largest], each), _LEAST)
            for number, name in enumerate(CHECKS)
        },
    )
    write_atomically(out, made.to_bytes())
    return made


def check_share(found: Calibration) -> float:
    """Share of further satisfied runs in which one check raises an alarm at most, with 95 %.

    The 95th percentile over calibrations of its distribution, see
    :mod:`taxinet_ros.core.assurance.monitor`: Clopper and Pearson's bound of the runs above it.
    """
    rank = conformal_rank(found.runs, found.rate / len(CHECKS))
    return share_bounds(found.runs - rank, rank, 0.05)[1]


def _as_stored(usual: Usual) -> Usual:
    """As in the file, so that the thresholds belong to what is read from it."""
    return Usual(mean=usual.mean, whitening=usual.whitening.astype(np.float32).astype(np.float64))


def _source(perception: str) -> str:
    """The perception's name, or the absolute path of its file."""
    path, colon, name = perception.partition(':')
    file = Path(path)
    return f'{file.resolve()}{colon}{name}' if file.is_file() else perception


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class UsualRun:
    """What a satisfied run says of the usual.

    Attributes:
        pictures: (n, features) of some of its pictures.
        deviations: (m, 3) as of :meth:`.Consistency.deviations`.
        responses: (k, responses) to moves of some of its first pictures, where the aircraft is not
            yet on the line.
    """

    pictures: NDArray[np.float64]
    deviations: NDArray[np.float64]
    responses: NDArray[np.float64]


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


def _drive(
    scene: Scenario, perception: Perception, on_step: Callable[[Step, TaxiCommand], None]
) -> bool:
    """Run a scene with the shipped law; each step comes with the command before it.

    Returns:
        Whether it is satisfied.
    """
    before = rolling_on(scene.speed_mps)

    def take(step: Step) -> None:
        nonlocal before
        on_step(step, before)
        before = step.command

    specs = [parse_spec(REQUIREMENT)]
    judged = run_closed_loop(scene, perception, specs=specs, on_step=take)
    return outcome_of(judged) is Outcome.PASS


_worker: list[list[Perception]] = []
"""Of a worker process: the perception, as often as for :class:`.Moves` and once more."""


def _start_worker(word: str) -> None:
    _worker.append([make_perception(word), *make_perceptions(word)])


def _usual_run(scene: Scenario) -> UsualRun | None:
    """Make a run and see what is usual in it; None if it is not satisfied."""
    check_usual_rate(scene, 'calibration')
    perception, *others = _worker[-1]
    moves, consistency = Moves(scene, others), Consistency()
    pictures, deviations, responses = [], [], []

    def take(step: Step, before: TaxiCommand) -> None:
        image = step.observation.image
        assert image is not None
        if step.observation.seq % _EVERY == 0:
            pictures.append(features(image))
        seq = step.observation.seq
        if seq < _AT_FIRST and seq % _EVERY_AT_FIRST == 0 and step.estimate.usable:
            found = moves.responses(image, step.estimate)
            if np.isfinite(found).all():
                responses.append(found)
        changed = consistency.deviations(step.estimate, before) if step.estimate.usable else None
        if changed is not None:
            deviations.append(changed)

    if not _drive(scene, perception, take) or not deviations or not responses:
        return None
    return UsualRun(
        pictures=np.array(pictures), deviations=np.array(deviations),
        responses=np.array(responses),
    )


def _largest(given: tuple[Scenario, Fitted]) -> NDArray[np.float64] | None:
    """Largest score of a run, by check, given what is usual; None if it is not satisfied."""
    (scene, fitted), (perception, *others) = given, _worker[-1]
    checks = RawChecks(fitted, scene, others)
    largest = np.zeros(len(CHECKS))

    def take(step: Step, before: TaxiCommand) -> None:
        assert step.observation.image is not None
        scores = checks.scores(
            Seen(image=step.observation.image, estimate=step.estimate, command=before)
        )
        np.maximum(largest, math.inf if scores is None else scores, out=largest)

    return largest if _drive(scene, perception, take) else None


def _each(
    function: Callable[[_T], _R], items: Sequence[_T], work: tuple[str, int], stage: str,
    progress: Progress,
) -> Iterator[_R]:
    """Results in the order of the items, whatever the number of processes."""
    perception, workers = work
    with process_pool(workers, 'calibration worker', _start_worker, perception) as pool:
        for done, result in enumerate(pool.map(function, items, chunksize=4), 1):
            yield result
            progress(stage, done, len(items))
