"""One run in this process, a picture of a scene, and the robustness of a trace; all without ROS.

A run here is the reference that the graph of nodes matches to the bit: the same scenario, network,
controller and requirements give the same trace, frames and robustness in both.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.campaign.options import DEFAULT_SPECS, read_specs
from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.controller import STEERING, Controller, SteeringGains, make_controller
from taxinet_ros.core.judging import parse_stop_on
from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import offline
from taxinet_ros.core.mtl.interval import RobustnessInterval
from taxinet_ros.core.mtl.specs import Spec, parse_spec
from taxinet_ros.core.outcome import Outcome, outcome_of
from taxinet_ros.core.perception.perception import (
    NO_ESTIMATE,
    Perception,
    make_perception,
    read_estimate,
)
from taxinet_ros.core.run_statistics import RunStatistics
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.trace import columns_of_steps, trace_signals, trace_table
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand, TrackingError
from taxinet_ros.core.user_code import IMPLEMENTATION, pair_of_numbers
from taxinet_ros.core.world import SimulatedWorld, WorldMaker, find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import KMWH

if TYPE_CHECKING:
    import pandas as pd

_MOST_S = 1e9
Frame = NDArray[np.uint8]
Look = Callable[[Any], Any]
"""A frame, (200, 360, 3) uint8 RGB, in; ``(cte_m, he_rad)`` or None out. One with an attribute
``needs_image = False`` is given the true :class:`TrackingError` instead."""
Steer = Callable[[TrackingError], Any]
"""An estimate in; ``(steering_rad, speed_mps)`` or a :class:`TaxiCommand` out."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Run:
    """One closed-loop run that is over.

    Attributes:
        scenario: initial condition and environment.
        perception: word of what estimated; ``python`` for a function.
        fingerprint: SHA-256 of its weights or file; '' for the truth and for a function given.
        specs: the requirements, the headline first.
        outcome: PASS, FAIL, or INFRA_ERROR where a sample could not be judged (a formula read an
            estimate that was not there).
        rho: robustness by the name of the requirement, in the unit of the predicate that decides;
            > 0 satisfies it. An interval of some width is of a run that was stopped early, or that
            could not be judged.
        stopped_early: whether the run ended before its end because that was decided.
        statistics: how far off, when settled, how wrong the estimates.
        steps: its control steps, without their frames.
        make_world: makes the world that it took place in.
    """

    scenario: Scenario
    perception: str
    fingerprint: str
    specs: tuple[Spec, ...]
    outcome: Outcome
    rho: Mapping[str, RobustnessInterval]
    stopped_early: bool
    statistics: RunStatistics
    steps: tuple[Step, ...]
    make_world: WorldMaker = SimulatedWorld

    @cached_property
    def trace(self) -> pd.DataFrame:
        """A row for each control step (10 Hz); units are in ``trace.attrs['units']``.

        Columns: ``t_s``, ``seq``, ``t_ns``, ``est_valid``, ``x_m``, ``y_m``, ``speed_mps``, true
        ``cte_m`` and ``he_rad``, estimated ``est_cte_m`` and ``est_he_rad`` (NaN where there is
        none), ``steering_rad``, ``speed_cmd_mps``, and for each requirement ``rho_lower.<name>``
        and ``rho_upper.<name>``; cross-track, heading and steering are left positive.
        """
        return trace_table(columns_of_steps(self.steps, [spec.name for spec in self.specs]))

    def frame(self, seq: int) -> Frame:
        """What the camera saw at a control step, (200, 360, 3) uint8 RGB.

        Raises:
            UsageError: the run has no such step.
        """
        if not 0 <= seq < len(self.steps):
            raise UsageError(f'run: no control step {seq}; it has 0 to {len(self.steps) - 1}')
        return next(self._driven_again(lambda now: now == seq))

    def frames(self) -> Iterator[Frame]:
        """What the camera saw, a frame for each control step in order; each is made when asked for.

        Frames are not kept (216 kB each): the aircraft is driven again by the run's commands, which
        gives every byte as it was.
        """
        return self._driven_again(lambda now: True)

    def __repr__(self) -> str:
        known = ', '.join(f'{name}: {interval.words()}' for name, interval in self.rho.items())
        return f'<Run {self.outcome}, {len(self.steps)} steps, {known}>'

    def _driven_again(self, wanted: Callable[[int], bool]) -> Iterator[Frame]:
        world = self.make_world(self.scenario)
        for step in self.steps:
            asked = wanted(step.observation.seq)
            now = world.observe(picture=asked)
            if asked and now.image is not None:
                yield now.image
            if step is not self.steps[-1]:
                world.advance(step.command)


def load_perception(word_or_file: str) -> Perception:
    """A perception, loaded once for many runs.

    Args:
        word_or_file: ``truth``, a shipped network (``taxinet``, ``original``, ...), a file of
            weights (``.safetensors``) or of a network (``.onnx``), or ``FILE.py:NAME``.

    Returns:
        What :func:`run` takes; ``estimate(image, truth)`` answers a :class:`TrackingError` to a
        frame (200, 360, 3) uint8 RGB.

    Raises:
        UsageError: an unknown word (the known ones are listed), or a file that cannot be used.
    """
    return make_perception(word_or_file)


def run(
    scenario: Scenario, *, perception: str | Perception | Look = 'truth',
    controller: str | Controller | Steer = STEERING,
    specs: str | Spec | Sequence[str | Spec] = DEFAULT_SPECS, stop_on: str = 'never',
    world: str = KMWH,
) -> Run:
    """Run one scenario to its end, in this process.

    Args:
        scenario: initial condition and environment.
        perception: a word or file as of :func:`load_perception`, what that gave, or a function
            from a frame, (200, 360, 3) uint8 RGB, to ``(cte_m, he_rad)``, left positive, or None.
        controller: ``steering``, ``FILE.py:NAME``, ``tx.SteeringLaw(tx.SteeringGains(...))``, or a
            function from a :class:`TrackingError` to ``(steering_rad, speed_mps)``.
        specs: names of shipped formulas, ``NAME=FORMULA``, formulas, YAML files of them, or
            :class:`Spec`; the first is the headline.
        stop_on: ``never``, or end as soon as the headline is ``violated`` or all is ``decided``.
        world: ``kmwh``, the simulated one, or what a package adds (docs/extending.md).

    Returns:
        The run with its trace, robustness and outcome.

    Raises:
        UsageError: a word, file or formula is not known, a formula looks beyond the run, or a
            function answered something else.
        UserCodeError: a function in a file failed; what a function given here raises comes through.
        InfraError: the simulator failed.
    """
    eyes, make_world = _perception(perception), find_world(world).make
    asked = tuple(map(parse_spec, spec_texts(specs)))
    steps: list[Step] = []

    def keep(step: Step) -> None:
        seen = dataclasses.replace(step.observation, image=None)
        steps.append(dataclasses.replace(step, observation=seen))

    judgement = run_closed_loop(
        scenario, eyes, specs=asked, controller=_controller(controller),
        stop_on=parse_stop_on(stop_on), on_step=keep, make_world=make_world,
    )
    return Run(
        scenario=scenario, perception=eyes.word, fingerprint=eyes.fingerprint, specs=asked,
        outcome=outcome_of(judgement),
        rho={
            spec.name: reading.interval
            for spec, reading in zip(asked, judgement.readings, strict=True)
        },
        stopped_early=judgement.stopped_early, statistics=judgement.statistics, steps=tuple(steps),
        make_world=make_world,
    )


def render(
    scenario: Scenario, pose: AircraftState | tuple[float, float, float] | None = None, *,
    t_s: float = 0.0,
) -> Frame:
    """Photograph a scene with the wing camera.

    Args:
        scenario: light, weather and runway; without a pose its start pose too, which gives the
            first frame of its run.
        pose: ``(x_m, cte_m, he_rad)``: metres past the threshold, metres left of the centreline,
            heading error in radians, left positive; the aircraft stands there as at the start of
            a run. Or a whole :class:`AircraftState`.
        t_s: simulated time [s], by which clouds and rain move.

    Returns:
        (200, 360, 3) uint8 RGB.

    Raises:
        UsageError: the pose is outside what a scenario may start from, or time is negative.
    """
    if not 0 <= t_s < math.inf:
        raise UsageError(f'render: t_s is {t_s:g}; expected 0 or more seconds')
    if not isinstance(pose, AircraftState):
        start = scenario
        if pose is not None:
            x_m, cte_m, he_rad = pose
            start = dataclasses.replace(
                scenario, distance_m=x_m, cross_track_m=cte_m, heading_rad=he_rad
            )
        pose = Aircraft(start).state
    return Camera(scenario).render(pose, round(t_s * NS_PER_S))


def robustness(spec: str | Spec, trace: pd.DataFrame) -> float:
    """Robustness of a requirement on a finished trace, whose last row is taken for its end.

    Args:
        spec: name of a shipped formula, ``NAME=FORMULA``, a formula, or a :class:`Spec`.
        trace: a row per sample, in time. ``t_ns`` (integer nanoseconds) or else ``t_s`` says when.
            A formula reads the signals ``cte``, ``he``, ``x``, ``speed``, ``steering``,
            ``cte_estimate``, ``he_estimate``, ``estimate_gap`` and ``unusable_share`` of the
            columns of :attr:`Run.trace`, and any column with numbers by its own name.

    Returns:
        Signed distance from violation, in the unit of the predicate that decides; > 0 is satisfied.

    Raises:
        UsageError: a bad formula, no time, a signal without a column, or one that is not finite
            where the formula reads it (an estimate that is missing has no robustness).
    """
    stamps_ns = _stamps_ns(trace)
    numbers = {
        str(name): trace[name].to_numpy() for name in trace.columns
        if trace[name].dtype.kind in 'biuf'
    }
    signals = trace_signals(stamps_ns, numbers)
    signals |= {name: column for name, column in numbers.items() if name.isidentifier()}
    asked = spec if isinstance(spec, Spec) else parse_spec(spec, signals=tuple(signals))
    return offline.robustness(asked.formula, stamps_ns, signals)


def _stamps_ns(trace: pd.DataFrame) -> NDArray[np.int64]:
    if 't_ns' in trace.columns:
        _check_time(trace, 't_ns', 'iu', 'integer nanoseconds')
        return trace['t_ns'].to_numpy()
    if 't_s' not in trace.columns:
        known = ', '.join(map(str, trace.columns)) or 'none'
        raise UsageError(f'trace: no column t_ns or t_s; it has: {known}')
    _check_time(trace, 't_s', 'iuf', 'seconds as numbers')
    seconds = trace['t_s'].to_numpy(dtype=np.float64)
    if not np.isfinite(seconds).all():
        raise UsageError(f'trace: t_s is not finite at row {np.isfinite(seconds).argmin()}')
    if (np.abs(seconds) > _MOST_S).any():
        row = int((np.abs(seconds) > _MOST_S).argmax())
        raise UsageError(f'trace: t_s is {seconds[row]:g} s at row {row}, beyond {_MOST_S:g}')
    return np.rint(seconds * NS_PER_S).astype(np.int64)


def _check_time(trace: pd.DataFrame, name: str, kinds: str, expected: str) -> None:
    column = trace[name]
    if getattr(column, 'ndim', 1) != 1 or column.dtype.kind not in kinds:
        kind = getattr(column, 'dtype', 'several columns')
        raise UsageError(f'trace: {name} holds {kind}; expected {expected}')


def spec_texts(specs: str | Spec | Sequence[str | Spec]) -> tuple[str, ...]:
    """Requirements as text that needs no file.

    Raises:
        UsageError: there is none, or one is not known.
    """
    asked = (specs,) if isinstance(specs, str | Spec) else specs
    if not isinstance(asked, list | tuple) or not all(isinstance(one, str | Spec) for one in asked):
        raise UsageError(
            f'specs: got {specs!r:.60}; expected a requirement or a list of them, each a text, as '
            'in specs=["phi_always", "slow=always(speed <= 6)"]'
        )
    if not asked:
        raise UsageError('specs: no requirement; name one, as in specs="phi_always"')
    return read_specs(f'{one.name}={one.text}' if isinstance(one, Spec) else one for one in asked)


def _perception(given: str | Perception | Look) -> Perception:
    if isinstance(given, str):
        return make_perception(given)
    if hasattr(given, 'estimate'):
        return cast('Perception', given)
    if callable(given):
        return _FunctionPerception(given)
    raise UsageError(f'perception: {given!r:.60} is neither a word, a perception nor a function')


def _controller(given: str | Controller | Steer) -> Controller:
    if isinstance(given, str):
        return make_controller(given, SteeringGains())
    if hasattr(given, 'command'):
        return cast('Controller', given)
    if callable(given):
        return _FunctionController(given)
    raise UsageError(f'controller: {given!r:.60} is neither a word, a controller nor a function')


def _reset(function: object) -> None:
    reset = getattr(function, 'reset', None)
    if reset is not None:
        reset()


class _FunctionPerception(Perception):
    """A function of the caller's, called as one in a file is; what it raises comes through."""

    word = IMPLEMENTATION
    fingerprint = ''

    def __init__(self, look: Look) -> None:
        self._look = look
        self.needs_image = bool(getattr(look, 'needs_image', True))

    def begin(self) -> None:
        """Have it forget the run before, if it has a ``reset()``."""
        _reset(self._look)

    def estimate(self, image: Frame | None, truth: TrackingError | None) -> TrackingError:
        """What it answers."""
        if (image if self.needs_image else truth) is None:
            return NO_ESTIMATE
        # A copy, for it may write on what is its own.
        answer = self._look(image.copy() if self.needs_image and image is not None else truth)
        found = read_estimate(answer)
        if found is None:
            raise UsageError(
                f'perception: answered {answer!r:.60}; expected (cte_m, he_rad), or None'
            )
        return found


class _FunctionController(Controller):
    """A function of the caller's; what it raises comes through."""

    word = IMPLEMENTATION
    fingerprint = ''

    def __init__(self, steer: Steer) -> None:
        self._steer = steer

    def begin(self) -> None:
        """Have it forget the run before, if it has a ``reset()``."""
        _reset(self._steer)

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """What it answers."""
        answer = self._steer(estimate)
        pair = (answer.steering_rad, answer.speed_mps) if isinstance(answer, TaxiCommand) \
            else pair_of_numbers(answer)
        if pair is None or not (math.isfinite(pair[0]) and 0 <= pair[1] < math.inf):
            raise UsageError(
                f'controller: answered {answer!r:.60}; expected (steering_rad, speed_mps), finite '
                'and speed not negative'
            )
        return TaxiCommand(steering_rad=pair[0], speed_mps=pair[1])
