"""Runs in this process, without ROS: rows and bags equal the graph's to the byte.

The closed loop is that of :mod:`taxinet_ros.core.loop`; its messages are written as the recorder
node writes them. A run that breaks names the node that would have failed in the graph.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from taxinet_ros.bag.layout import run_folder
from taxinet_ros.bag.rewrite.frames import restore_in_place
from taxinet_ros.bag.run.run_bag import RunBag, RunEnding, node_words
from taxinet_ros.bag.writer import MIN_FREE_BYTES
from taxinet_ros.core import topics
from taxinet_ros.core.assurance.switch import make_controller
from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.motion.controller import Controller, SteeringGains
from taxinet_ros.core.pacing.timing import Timing
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.perception.substituted import parse_substitution, substituted
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.system import System
from taxinet_ros.core.types import TrackingError
from taxinet_ros.core.verdict.judge import Judgement
from taxinet_ros.core.verdict.outcome import NOT_JUDGED, Outcome, RunRequest, RunResult, outcome_of
from taxinet_ros.core.world import ChosenWorld, World, close_world, find_world
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.trials.record.facts import program_attachment
from taxinet_ros.trials.worker_pool import Task

OnStep = Callable[[int], None]


class Observer(Protocol):
    """Looks on at a run, step by step, and gives plain values of what it saw."""

    def take(self, step: Step) -> None:
        """Look at a step."""

    def values(self) -> Mapping[str, Any]:
        """Plain values, after the last step."""


@dataclass(frozen=True, kw_only=True)
class _Parts:
    """A system with its parts loaded."""

    system: System
    perception: Perception
    controller: Controller
    world: ChosenWorld


def _load(system: System, before: _Parts | None) -> _Parts:
    """Load the parts of a system; a network is kept from the one before."""
    if before is not None and before.system.perception == system.perception:
        perception = before.perception
    else:
        perception = make_perception(system.perception)
    controller = make_controller(system.controller, SteeringGains(**system.gains))
    if system.controller_sha256 not in ('', controller.fingerprint):
        raise UsageError(
            f'controller {system.controller} has changed since this began; put it back'
        )
    world = find_world(system.world, system.world_sha256)
    return _Parts(system=system, perception=perception, controller=controller, world=world)


class Loop:
    """Executes requested runs one by one.

    Attributes:
        interrupted: whether :meth:`interrupt` was called.
    """

    def __init__(
        self, system: System | None = None, out: Path | None = None, images: str = 'none'
    ) -> None:
        """Load the parts of a system.

        Args:
            system: what drives, unless a :class:`.Task` names another system; None: each does.
            out: folder of the campaign, which exists, for the bags; None: no bags.
            images: runs whose camera frames are recorded: ``all``, ``failures`` or ``none``.

        Raises:
            UsageError: a part cannot be used, or has changed since the campaign began.
        """
        self.interrupted = False
        self._out, self._images = out, images
        self._parts = None if system is None else _load(system, None)

    def run(self, request: RunRequest, on_step: OnStep = lambda seq: None) -> RunResult:
        """Run a request.

        Args:
            request: the requested run.
            on_step: called with the number of every control step.

        Returns:
            The same result as from a graph, except for the time that it took; INTERRUPTED after
            :meth:`interrupt`.

        Raises:
            UsageError: a part of a task's system cannot be used.
        """
        begun_s = time.monotonic()
        parts, perception = self._parts_of(request)
        watched = _Watched(perception, parts.controller, parts.world)
        try:
            with _Blamed(topics.RECORDER, InfraKind.BAG):
                bag = self._open_bag(request, parts)
            result = self._run(request, watched, bag, on_step)
        except InfraError as error:  # of the recording
            result = RunResult.infra_error(error.kind, error.who, error.detail, watched.seq)
        return replace(
            result, perception=parts.perception.word, fingerprint=parts.perception.fingerprint,
            wall_s=time.monotonic() - begun_s,
        )

    def interrupt(self) -> None:
        """End the current run at its next control step; safe to call from another thread."""
        self.interrupted = True

    def _parts_of(self, request: RunRequest) -> tuple[_Parts, Perception]:
        """The parts that drive, and the perception or what a task has in its place."""
        if isinstance(request, Task) and (
            self._parts is None or self._parts.system != request.system
        ):
            self._parts = _load(request.system, self._parts)
        parts = self._parts
        assert parts is not None, 'neither loop nor request name a system'
        if not isinstance(request, Task):
            return parts, parts.perception
        return parts, substituted(
            parse_substitution(request.word, ()), parts.perception, (request.seed, request.index),
            request.scenario.period_ns,
        )

    def _run(
        self, request: RunRequest, watched: _Watched, bag: RunBag | None, on_step: OnStep
    ) -> RunResult:
        if bag is None:
            return self._drive(request, watched, lambda step: on_step(watched.seq))[0]
        filmed = self._images == 'all'

        def record(step: Step) -> None:
            with _Blamed(topics.RECORDER, InfraKind.BAG):
                bag.step(step, step.observation.image if filmed else None)
            on_step(watched.seq)

        try:
            result, judged = self._drive(request, watched, record, filmed=filmed)
            with _Blamed(topics.RECORDER, InfraKind.BAG):
                if not watched.complete and watched.now is not None:
                    picture = watched.now.image if filmed else None
                    bag.torn_step(watched.now, picture, watched.estimate)
                bag.end(_ending(result, watched.perception), result.last_seq, judged)
        except BaseException:
            bag.abandon()
            raise
        return self._with_frames(bag, result, on_step)

    def _drive(
        self, request: RunRequest, watched: _Watched, on_step: Callable[[Step], None], *,
        filmed: bool = False,
    ) -> tuple[RunResult, Judgement | None]:
        """Drive the closed loop to its end; the judgement is None if it broke."""
        def make_world(scenario: Scenario, *, pictures: bool = True) -> World:
            return watched.world(scenario, pictures=pictures or filmed)

        def take(step: Step) -> None:
            watched.complete = True
            if observer is not None:
                with _Blamed(topics.STEERING_CONTROLLER):
                    observer.take(step)
            on_step(step)
            if self.interrupted:
                raise _InterruptedError

        assert self._parts is not None
        judging, timing = request.judging, self._parts.system.timing
        try:
            observer = _observer(request)
            judged = run_closed_loop(
                request.scenario, watched.perception, specs=judging.parsed_specs,
                controller=watched.controller, stop_on=judging.stop_on,
                assumptions=judging.assumptions, on_step=take, timing=timing,
                draws=(request.seed, request.index), make_world=make_world,
            )
        except _InterruptedError:
            return RunResult(outcome=Outcome.INTERRUPTED, last_seq=watched.seq), None
        except InfraError as error:
            if error.who == topics.RECORDER:
                raise
            return RunResult.infra_error(error.kind, error.who, error.detail, watched.seq), None
        seen = {} if observer is None else observer.values()
        return _judged(request, judged, watched.seq, timing, seen), judged

    def _open_bag(self, request: RunRequest, parts: _Parts) -> RunBag | None:
        if self._out is None:
            return None
        nodes = node_words(
            parts.perception, parts.controller, parts.world, parts.system.timing,
            request.scenario,
        )
        return RunBag(
            run_folder(self._out, request.run_id), request, nodes, images=self._images == 'all',
            attachments=program_attachment(request.program, self._out), make_parents=False,
        )

    def _with_frames(self, bag: RunBag, result: RunResult, on_step: OnStep) -> RunResult:
        """Add the camera frames of a failed run, if they are recorded for failures only."""
        failed = result.outcome in (Outcome.FAIL, Outcome.INFRA_ERROR)
        if self._images != 'failures' or not failed:
            return result
        try:
            for seq in restore_in_place(bag.folder, MIN_FREE_BYTES):
                on_step(seq)
        except Exception as error:
            if result.outcome.judged:  # an infrastructure error has its own reason to report
                detail = f'frames not kept: {_one_line(error)}'
                return RunResult.infra_error(
                    InfraKind.BAG, topics.RECORDER, detail, result.last_seq
                )
        return result


def _observer(request: RunRequest) -> Observer | None:
    if not (isinstance(request, Task) and request.observer):
        return None
    module, _, name = request.observer.partition(':')
    with _Blamed(topics.STEERING_CONTROLLER):
        made: Observer = getattr(importlib.import_module(module), name)(
            request.scenario, request.observed
        )
        return made


def _ending(result: RunResult, perception: Perception) -> RunEnding:
    return RunEnding(
        outcome=result.outcome, kind=result.kind, who=result.who, detail=result.detail,
        perception=perception.word, fingerprint=perception.fingerprint,
    )


def _judged(
    request: RunRequest, judged: Judgement, seq: int, timing: Timing, seen: Mapping[str, Any]
) -> RunResult:
    outcome = outcome_of(judged)
    if not outcome.judged:
        return RunResult.infra_error(last_seq=seq, **NOT_JUDGED)
    readings = zip(request.judging.parsed_specs, judged.readings, strict=True)
    return RunResult(
        outcome=outcome, last_seq=seq,
        robustness={spec.name: reading.interval for spec, reading in readings},
        stopped_early=judged.stopped_early, statistics=judged.statistics, timing=timing.words,
        seen=seen,
    )


class _InterruptedError(Exception):
    """The run is to end at this step."""


class _Part:
    """A part of a run: its failures name the node of the graph that has the part."""

    def __init__(
        self, part: Any, node: str, kind: InfraKind = InfraKind.NODE_ERROR,
        seen: Callable[[str, Any], None] = lambda method, result: None,
    ) -> None:
        self._part, self._blamed, self._seen = part, _Blamed(node, kind), seen

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._part, name)
        if not callable(found):
            return found

        def call(*arguments: Any, **named: Any) -> Any:
            with self._blamed:
                result = found(*arguments, **named)
            self._seen(name, result)
            return result

        setattr(self, name, call)  # the next step finds it without this
        return call

    def close(self) -> None:
        """Close a world that has something to give back."""
        with self._blamed:
            close_world(self._part)


class _Watched:
    """The parts of one run, and how far the current control step has come."""

    def __init__(
        self, perception: Perception, controller: Controller, world: ChosenWorld
    ) -> None:
        self.perception: Any = _Part(perception, topics.PERCEPTION, seen=self._take)
        self.controller: Any = _Part(controller, topics.STEERING_CONTROLLER)
        self.now: Observation | None = None
        self.estimate: TrackingError | None = None
        self.complete = False
        self._world = world

    def world(self, scenario: Scenario, *, pictures: bool) -> Any:
        """Make the world of the run."""
        with _Blamed(topics.SIMULATOR, InfraKind.SIM):
            world = self._world.make(scenario, pictures=pictures)
        return _Part(world, topics.SIMULATOR, InfraKind.SIM, self._take)

    def _take(self, method: str, result: Any) -> None:
        if method == 'observe':
            self.now, self.estimate, self.complete = result, None, False
        elif method == 'estimate':
            self.estimate = result

    @property
    def seq(self) -> int:
        """The current control step, -1 before the first."""
        return -1 if self.now is None else self.now.seq


class _Blamed:
    """Context in which a part runs; its failure is an infrastructure error of its node."""

    def __init__(self, node: str, kind: InfraKind = InfraKind.NODE_ERROR) -> None:
        self._node, self._kind = node, kind

    def __enter__(self) -> None:
        return

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, Exception) and not isinstance(error, InfraError):
            raise InfraError(self._kind, self._node, -1, _one_line(error)) from error


def _one_line(error: BaseException) -> str:
    return f'{type(error).__name__}: {error}'.splitlines()[0]
