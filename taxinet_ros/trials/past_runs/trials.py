"""Trials: scenes run once more in the closed loop without ROS, in worker processes, and kept.

A :class:`TrialSystem` is what drives, and by which requirements it is judged; a :class:`Task` is a
scene to run; a :class:`Trial` is its result. A :class:`TrialRecord` keeps results in
``campaign.db``, so a command that is run again makes only those that are missing.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar

import cv2
from threadpoolctl import threadpool_limits

from taxinet_ros.core.assurance.switch import make_controller
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.controller import Controller, SteeringGains
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.perception.substituted import parse_substitution, substituted
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.system import System, digest_of
from taxinet_ros.core.user_code import UserCodeError
from taxinet_ros.core.verdict.judge import Judgement
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, outcome_of
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import InfraError, UsageError, warn_once
from taxinet_ros.files.record import RECORD_NAME, Record, plain, repair_record, repaired
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.trials.options import make_out

SETTINGS, SITTING, TRIAL = 'settings', 'sitting', 'trial'
"""Kinds of the entries of a record of trials: settings, machine of each sitting, results."""


@dataclass(frozen=True, kw_only=True)
class TrialSystem(System):
    """A system, and how its trials are judged.

    Attributes:
        judging: judging options of the verdicts.
    """

    judging: Judging

    @property
    def digest(self) -> str:
        """Digest of all that decides the result of a scene. Raises as that of :class:`System`."""
        return digest_of([super().digest, self.judging.facts()])


@dataclass(frozen=True, kw_only=True, slots=True)
class Task:
    """One trial to run.

    Attributes:
        run_id: name of the run that is repeated.
        scenario: its scene.
        word: word of the substitution.
        seed: seed of its noise: seed and index of the run, which also determine drawn latencies.
        exact: whether the scene is bit-exact.
        gains: steering gains in place of the system's, or None.
    """

    run_id: str
    scenario: Scenario
    word: str
    seed: tuple[int, int]
    exact: bool = True
    gains: Mapping[str, float] | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """Result of one trial.

    Attributes:
        run_id: name of the run that is repeated.
        word: word of the substitution.
        passed: whether all formulas were satisfied; None if the run could not be judged.
        detail: reason why it could not be judged.
        exact: whether its scene was bit-exact, so that it must reproduce the recorded result.
        robustness: robustness of the headline; exact unless the run was stopped early.
        max_cross_track_m, settle_time_s, left_runway: statistics of the path, see
            :class:`~taxinet_ros.core.verdict.run_statistics.RunStatistics`; None if unknown.
    """

    run_id: str
    word: str
    passed: bool | None
    detail: str = ''
    exact: bool = True
    robustness: RobustnessInterval | None = None
    max_cross_track_m: float | None = None
    settle_time_s: float | None = None
    left_runway: bool | None = None

    @property
    def judged(self) -> bool:
        """Whether it has a verdict."""
        return self.passed is not None

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of :meth:`from_json`."""
        values = asdict(self)
        values['rho_lower'], values['rho_upper'] = values.pop('robustness') or (None, None)
        return values

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Create from the values of :meth:`to_json`.

        Raises:
            KeyError, TypeError: a field is missing or unknown.
        """
        columns = dict(values)
        ends = columns.pop('rho_lower'), columns.pop('rho_upper')
        return cls(**columns, robustness=None if None in ends else RobustnessInterval(*ends))


# Running -----------------------------------------------------------------------------------------


@contextlib.contextmanager
def trial_pool(
    system: TrialSystem, workers: int
) -> Iterator[Callable[[Iterable[Task]], Iterator[Trial]]]:
    """Context of a function that runs trials in worker processes and yields them as they finish.

    Its tasks are read only as fast as trials can run, so they may end on an interrupt; trials in
    flight are still completed.

    Raises:
        InfraError: a worker process died.
    """
    with process_pool(workers, 'trial worker', _start_worker, system) as pool:
        yield lambda tasks: pool.run_all(_trial, tasks, workers)


def run_trials(tasks: Iterable[Task], system: TrialSystem, workers: int) -> Iterator[Trial]:
    """Run trials as the function of :func:`trial_pool` does."""
    with trial_pool(system, workers) as run:
        yield from run(tasks)


_worker: list[tuple[TrialSystem, Perception, Controller]] = []
"""State of a worker process: system, network and controller."""


def _start_worker(system: TrialSystem) -> None:
    cv2.setNumThreads(1)  # the workers share the cores
    threadpool_limits(limits=1)
    controller = make_controller(system.controller, SteeringGains(**system.gains))
    _worker.append((system, make_perception(system.perception), controller))


def _trial(task: Task) -> Trial:
    return make_trial(task, *_worker[0])


def make_trial(
    task: Task, system: TrialSystem, network: Perception, controller: Controller | None = None
) -> Trial:
    """Run one scene in this process; loads the system's controller if none is given."""
    if controller is None or task.gains is not None:
        gains = system.gains if task.gains is None else task.gains
        controller = make_controller(system.controller, SteeringGains(**gains))
    perception = substituted(parse_substitution(task.word), network, task.seed)
    try:
        judged = run_closed_loop(
            task.scenario, perception, specs=system.judging.parsed_specs, controller=controller,
            stop_on=system.judging.stop_on, assumptions=system.judging.assumptions,
            timing=system.timing, draws=task.seed,
            make_world=find_world(system.world, system.world_sha256).make,
        )
    except (InfraError, UserCodeError) as error:
        return _unjudged(task, str(error))
    return _judged(task, judged)


def _judged(task: Task, judged: Judgement) -> Trial:
    stopped, statistics = judged.stopped_early, judged.statistics
    outcome = outcome_of(judged)
    if not outcome.judged:
        return _unjudged(task, 'a sample could not be judged')
    settled = not stopped and not math.isnan(statistics.settle_time_s)
    return Trial(
        run_id=task.run_id, word=task.word, passed=outcome is Outcome.PASS, exact=task.exact,
        robustness=judged.readings[0].interval,
        max_cross_track_m=statistics.max_cross_track_m,
        settle_time_s=statistics.settle_time_s if settled else None,
        # After an early stop it is unknown whether the run would have left the runway.
        left_runway=statistics.left_runway or (None if stopped else False),
    )


def _unjudged(task: Task, detail: str) -> Trial:
    return Trial(
        run_id=task.run_id, word=task.word, passed=None, detail=detail, exact=task.exact
    )


# Keeping -----------------------------------------------------------------------------------------


class Result(Protocol):
    """What a :class:`TrialRecord` keeps."""

    @property
    def judged(self) -> bool:
        """Whether it counts; another one is made again by the next sitting."""

    def to_json(self) -> dict[str, Any]:
        """Plain values."""

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """The inverse of :meth:`to_json`."""


_R = TypeVar('_R', bound=Result)


def check_trials_folder(out: Path) -> None:
    """Check that a folder can have trials: it is new or empty, or has a record.

    Raises:
        UsageError: it contains something else, such as trials of an earlier version.
    """
    if out.is_dir() and not (out / RECORD_NAME).exists() and (names := sorted(out.iterdir())):
        raise UsageError(
            f'--out {out}: contains something else ({names[0].name}); choose another folder'
        )


class TrialRecord(Generic[_R]):
    """Results kept in a folder, for one command at a time. A context manager.

    Attributes:
        done: results by key: the judged ones of earlier sittings, and all of this one.
    """

    def __init__(self, out: Path, settings: Mapping[str, Any], kind: type[_R], other: str) -> None:
        """Open or create the record in ``out``.

        What a damaged record has lost is made again.

        Args:
            out: the folder.
            settings: plain values of everything that results depend on besides their keys.
            kind: class of the results.
            other: what a folder with other settings has, for the error message.

        Raises:
            UsageError: the folder cannot be used, contains something else, or trials with other
                settings; or another command uses it.
        """
        check_trials_folder(out)
        make_out(out)
        path = out / RECORD_NAME
        try:
            damaged = repair_record(path)
            self._record = Record(path)
        except OSError as error:
            raise UsageError(f'--out {out}: cannot be used: {error.strerror}') from error
        if damaged:
            warn_once(damaged)
        try:
            self._begin(f'--out {out}: {other}; choose another folder', settings)
            self.done = self._earlier(kind)
        except BaseException:
            self._record.close()
            raise

    def _begin(self, refusal: str, settings: Mapping[str, Any]) -> None:
        entries, made_on = self._record.entries, dict(provenance())
        if entries and entries.get(SETTINGS, {}).get('') != plain(settings):
            raise UsageError(refusal)
        sittings = entries.get(SITTING, {})
        last = max(sittings, default='0')
        if not sittings or sittings[last] != made_on:
            self._record.put_all([
                (SETTINGS, '', settings), (SITTING, f'{int(last) + 1:04}', made_on)
            ])
        repaired(self._record)

    def _earlier(self, kind: type[_R]) -> dict[str, _R]:
        found = {}
        for key, values in self._record.entries.get(TRIAL, {}).items():
            try:
                result = kind.from_json(values)
            except (LookupError, TypeError, ValueError) as error:
                raise UsageError(
                    f'{self._record.path}: trial {key!r} is of another version ({error}); choose '
                    'another --out'
                ) from error
            if result.judged:
                found[key] = result
        return found

    def keep(self, key: str, result: _R) -> None:
        """Write a result to the disk.

        Raises:
            OSError: it cannot be written, as on a full disk.
            RecordError: the folder was moved, deleted or replaced.
        """
        self._record.put(TRIAL, key, result.to_json())
        self.done[key] = result

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._record.close()
