"""Counterexamples run again in worker processes, each with something in the network's place."""

from __future__ import annotations

import itertools
import math
import multiprocessing
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from typing import Any, Self

import cv2
from threadpoolctl import threadpool_limits

from taxinet_ros.core.controller import STEERING, Controller, make_controller
from taxinet_ros.core.errors import InfraError
from taxinet_ros.core.judge import Judgement
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.mtl import parse_assumptions, parse_spec
from taxinet_ros.core.perception import Perception, make_perception
from taxinet_ros.core.pool_workers import end_with_parent, interrupts_blocked
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.steering import SteeringGains
from taxinet_ros.core.stop_on import StopOn
from taxinet_ros.core.substituted_perception import parse_substitution, substituted
from taxinet_ros.core.timing import parse_timing
from taxinet_ros.core.user_code import UserCodeError


@dataclass(frozen=True, kw_only=True, slots=True)
class Bench:
    """What all trials share.

    Attributes:
        perception: word or file of the network.
        specs: formulas as text, the headline first.
        gains: steering gains that differ from the defaults.
        controller: word of what steers.
        stop_on: what ends a run before its end.
        bounds, rates: what is vouched for of the signals, as text.
        timing: when answers take effect, in words.
    """

    perception: str
    specs: tuple[str, ...]
    gains: Mapping[str, float]
    controller: str = STEERING
    stop_on: StopOn = StopOn.NEVER
    bounds: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()
    timing: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Task:
    """One trial to be made.

    Attributes:
        run_id: the counterexample.
        scenario: its scene.
        word: of the substitution.
        seed: of its noise: seed and index of the run, which determine drawn latencies too.
        exact: whether the scene is known to the last bit.
    """

    run_id: str
    scenario: Scenario
    word: str
    seed: tuple[int, int]
    exact: bool = True


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """How a counterexample came out.

    Attributes:
        run_id: the counterexample.
        word: of the substitution.
        passed: whether all formulas were satisfied; None where the run could not be judged.
        detail: why it could not.
        exact: whether its scene was known to the last bit, so that it must come out as recorded.
        rho_lower, rho_upper: of the headline; equal unless the run was stopped before its end.
        max_cross_track_m, settle_time_s, left_runway: of the path, see
            :class:`~taxinet_ros.core.run_statistics.RunStatistics`; None where unknown.
    """

    run_id: str
    word: str
    passed: bool | None
    detail: str = ''
    exact: bool = True
    rho_lower: float | None = None
    rho_upper: float | None = None
    max_cross_track_m: float | None = None
    settle_time_s: float | None = None
    left_runway: bool | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of :meth:`from_json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Read back what :meth:`to_json` gave.

        Raises:
            TypeError: a field is missing or unknown.
        """
        return cls(**values)


def run_trials(tasks: Iterable[Task], bench: Bench, workers: int) -> Iterator[Trial]:
    """Make trials in worker processes; they come as they end.

    ``tasks`` is read only as fast as trials can be made, so it may end when somebody interrupts;
    those under way are still brought home.

    Raises:
        InfraError: a worker process died.
    """
    waiting = iter(tasks)
    context = multiprocessing.get_context('spawn')  # a fork would copy the threads of onnxruntime
    with ProcessPoolExecutor(workers, context, _start_worker, (bench,)) as pool:
        under_way: set[Future[Trial]] = set()
        try:
            while True:
                # One more than there are workers, so that none waits for us.
                for task in itertools.islice(waiting, workers + 1 - len(under_way)):
                    with interrupts_blocked():
                        under_way.add(pool.submit(_trial, task))
                if not under_way:
                    return
                done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in done)
        except BrokenProcessPool as error:
            raise InfraError('died', 'trial worker', -1, 'see the messages above') from error
        finally:
            pool.shutdown(cancel_futures=True)


_worker: list[tuple[Bench, Perception, Controller]] = []
"""In a worker process: what it was started with, its network, and what steers."""


def _start_worker(bench: Bench) -> None:
    end_with_parent()
    cv2.setNumThreads(1)  # the workers share the cores among themselves
    threadpool_limits(limits=1)
    controller = make_controller(bench.controller, SteeringGains(**bench.gains))
    _worker.append((bench, make_perception(bench.perception), controller))


def _trial(task: Task) -> Trial:
    return make_trial(task, *_worker[0])


def make_trial(
    task: Task, bench: Bench, network: Perception, controller: Controller | None = None
) -> Trial:
    """Run one scene in this process; the bench's controller is loaded where none is given."""
    controller = controller or make_controller(bench.controller, SteeringGains(**bench.gains))
    perception = substituted(parse_substitution(task.word), network, task.seed)
    try:
        judged = run_closed_loop(
            task.scenario, perception, specs=[parse_spec(text) for text in bench.specs],
            controller=controller, stop_on=bench.stop_on,
            assumptions=parse_assumptions(bench.bounds, bench.rates),
            timing=parse_timing(bench.timing), draws=task.seed,
        )
    except (InfraError, UserCodeError) as error:
        return _unjudged(task, str(error))
    return _judged(task, judged)


def _judged(task: Task, judged: Judgement) -> Trial:
    stopped, statistics = judged.stopped_early, judged.statistics
    if not (judged.complete or stopped):
        return _unjudged(task, 'a sample could not be judged')
    headline = judged.readings[0]
    settled = not stopped and not math.isnan(statistics.settle_time_s)
    return Trial(
        run_id=task.run_id, word=task.word, passed=judged.satisfied, exact=task.exact,
        rho_lower=headline.lower, rho_upper=headline.upper,
        max_cross_track_m=statistics.max_cross_track_m,
        settle_time_s=statistics.settle_time_s if settled else None,
        # Nobody knows whether a run that was stopped would have left the runway later.
        left_runway=statistics.left_runway or (None if stopped else False),
    )


def _unjudged(task: Task, detail: str) -> Trial:
    return Trial(
        run_id=task.run_id, word=task.word, passed=None, detail=detail, exact=task.exact
    )
