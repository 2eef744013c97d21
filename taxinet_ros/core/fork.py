"""A run that is repeated up to one control step and goes on in a changed world.

Up to the step the recorded estimates and commands hold, and the world is that of the recording; at
the step the scene, the place of the aircraft, the perception or the controller may change.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.control_step import Observation
from taxinet_ros.core.motion.aircraft import Aircraft, Placed
from taxinet_ros.core.motion.controller import Controller
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CROSSING,
    DURATION,
    EXPOSURE_JUMP,
    FAULT_SEED,
    GLARE_GHOST,
    GUST,
    GUST_SEED,
    LENS_DIRT,
    LENS_DROPS,
    RAIN,
    RUNWAY_STATE,
    SCENARIO_FIELDS,
    SHADOWS,
    SKY,
    STEERING_BIAS,
    STEERING_RATE_LIMIT,
    TIME_OF_DAY,
    WIND_DIRECTION,
    WIND_SPEED,
)
from taxinet_ros.core.sensors import NO_SENSORS, Measured
from taxinet_ros.core.signals import kept_signals
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError, step_stamp_ns
from taxinet_ros.core.world import ChosenWorld, SimulatedWorld, World
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import FORK

CHANGEABLE = (
    TIME_OF_DAY, BY_KEY['date'], SKY, RAIN, SHADOWS, CROSSING, WIND_SPEED, WIND_DIRECTION, GUST,
    GUST_SEED, RUNWAY_STATE, LENS_DIRT, LENS_DROPS, GLARE_GHOST, EXPOSURE_JUMP, FAULT_SEED,
    STEERING_BIAS, STEERING_RATE_LIMIT, DURATION,
)
"""Scenario keys that may change during a run. Others are its start, what stands on the ground and
what carries the camera, or delays of answers that are under way."""
MOVES = ('distance_m', 'cte_m', 'heading_deg', 'speed_mps')
"""Offsets by which the aircraft can be placed anew."""
_VERSION = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class Fork:
    """From when a run differs, and in what.

    Attributes:
        run_id: name of the run that was forked.
        sha256: SHA-256 of its bag.
        step: first control step of the changed world.
        scenario: the scene from there on; its start values are those of the run.
        placed: where the aircraft is placed anew at the step; None: it rolls on.
        perception, controller: words of those that were in effect before the step.
    """

    run_id: str
    sha256: str
    step: int
    scenario: Scenario
    placed: Placed | None
    perception: str
    controller: str

    @property
    def text(self) -> str:
        """Canonical JSON; the inverse of :func:`fork_of_text`."""
        placed = None if self.placed is None else dataclasses.asdict(self.placed)
        return json.dumps(
            {
                'version': _VERSION, 'run_id': self.run_id, 'sha256': self.sha256,
                'step': self.step, 'scenario': self.scenario.recorded(), 'placed': placed,
                'perception': self.perception, 'controller': self.controller,
            },
            sort_keys=True, allow_nan=False,
        )

    @property
    def fingerprint(self) -> str:
        """SHA-256 of :attr:`text`."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def at_s(self) -> float:
        """Simulated time of the step [s]."""
        return step_stamp_ns(self.step, self.scenario.period_ns) / NS_PER_S

    def changes(self, before: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
        """Values before and after, in the user's units, by the scenario keys that change.

        Args:
            before: the recorded scene, see :meth:`Scenario.to_human`.
        """
        old, new = before, self.scenario.to_human()
        return {
            key: (old.get(key), new.get(key)) for key in {**old, **new}
            if old.get(key) != new.get(key)
        }


def fork_of_text(text: str) -> Fork:
    """Read :attr:`Fork.text`.

    Raises:
        UsageError: it is of another version, or damaged.
    """
    try:
        told = json.loads(text)
        if told.pop('version') != _VERSION:
            raise UsageError('the fork was recorded by another version')
        placed = told.pop('placed')
        return Fork(
            **{
                **told, 'scenario': Scenario(**told['scenario']),
                'placed': None if placed is None else Placed(**placed),
            }
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UsageError(f'the record of the fork is damaged: {error}') from error


def check_changeable(before: Scenario, after: Scenario) -> None:
    """Refuse changes that cannot happen during a run.

    Raises:
        UsageError: there is one.
    """
    for field in SCENARIO_FIELDS:
        changed = getattr(before, field.attribute) != getattr(after, field.attribute) or (
            kept_signals(before.signals, [field]) != kept_signals(after.signals, [field])
        )
        if changed and field not in CHANGEABLE:
            known = ', '.join(one.key for one in CHANGEABLE)
            raise UsageError(
                f'fork: {field.key} cannot change during a run; what can: {known}; the pose of the '
                'aircraft by offsets'
            )


class ForkedWorld(World):
    """A simulated world that changes at the step of a fork."""

    def __init__(self, before: Scenario, fork: Fork, *, pictures: bool = True) -> None:
        """Begin as recorded.

        Args:
            before: the recorded scene, with the duration of the forked run.
            fork: what changes.
            pictures: False: none will be requested.

        Raises:
            UsageError: there are sensors, and a new pose or another seed.
        """
        anew = fork.placed is not None or fork.scenario.fault_seed != before.fault_seed
        if anew and before.sensors != NO_SENSORS:
            raise UsageError(
                'fork: in a run with sensors the aircraft cannot be placed anew, nor fault_seed '
                'change: what they measure goes on'
            )
        self._before, self._fork, self._pictures = before, fork, pictures
        self._world = SimulatedWorld(before, pictures=pictures)
        self.last_seq = self._world.last_seq
        self._seq, self._wheel_rad = 0, 0.0
        self._change()

    def observe(self, *, picture: bool = True) -> Observation:
        """Observe the current step; from the fork's step on in the changed world."""
        return self._world.observe(picture=picture)

    def advance(self, command: TaxiCommand) -> None:
        """Advance by one control period, and change the world at the fork's step."""
        self._world.advance(command)
        self._wheel_rad = command.steering_rad
        self._seq += 1
        self._change()

    def _change(self) -> None:
        fork = self._fork
        if self._seq != fork.step:
            return
        placed, after = fork.placed, fork.scenario
        aircraft = None if placed is None else Aircraft(after, placed=placed)
        self._world.change(after, aircraft=aircraft, wheel_rad=self._wheel_rad)


def needs_other_model(before: Scenario, after: Scenario) -> bool:
    """Whether the aircraft has to be placed anew: its model of windy air is another."""
    return before.windy != after.windy


def forked_world(fork: Fork) -> ChosenWorld:
    """The world of a forked run."""
    def make(scenario: Scenario, *, pictures: bool = True) -> World:
        return ForkedWorld(scenario, fork, pictures=pictures)

    return ChosenWorld(name=FORK, fingerprint=fork.fingerprint, make=make)


class ReplayedPerception(Perception):
    """The recorded estimates up to a step, then those of a perception.

    It sees the whole run, so that its answers are those of a perception that has been there from
    the beginning.
    """

    def __init__(
        self, after: Perception, recorded: Sequence[TrackingError], *, same: bool
    ) -> None:
        """Begin with the first estimate.

        Args:
            after: gives the estimates after the recorded ones.
            recorded: estimates of the steps before the fork.
            same: whether it gave the recorded ones and has to give them again.
        """
        self.word, self.fingerprint = after.word, after.fingerprint
        self.needs_image, self.needs_sensors = after.needs_image, after.needs_sensors
        self._after, self._recorded, self._same = after, recorded, same
        self._seq = 0

    def begin(self, rig: Rig | None = None) -> None:
        """Reset."""
        self._seq = 0
        self._after.begin(rig)

    def sense(self, measured: Measured) -> None:
        """Pass on what the sensors deliver."""
        self._after.sense(measured)

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return the recorded estimate of the step, or a new one.

        Raises:
            UsageError: the recorded one is not given again.
        """
        seq, self._seq = self._seq, self._seq + 1
        answer = self._after.estimate(image, truth)
        if seq >= len(self._recorded):
            return answer
        told = self._recorded[seq]
        if self._same:
            _check_same(f'perception {self.word}', seq, told, answer)
        return told


class ReplayedController(Controller):
    """The recorded commands up to a step, then those of a controller, which sees the whole run."""

    def __init__(self, after: Controller, recorded: Sequence[TaxiCommand], *, same: bool) -> None:
        """Begin with the first command; arguments as for :class:`ReplayedPerception`."""
        self.word, self.fingerprint = after.word, after.fingerprint
        self.needs_image, self.needs_sensors = after.needs_image, after.needs_sensors
        self._after, self._recorded, self._same = after, recorded, same
        self._seq = 0

    def see(self, image: NDArray[np.uint8]) -> None:
        """Pass the frame on."""
        self._after.see(image)

    def begin(self, scenario: Scenario | None = None) -> None:
        """Reset."""
        self._seq = 0
        self._after.begin(scenario)

    def sense(self, measured: Measured) -> None:
        """Pass on what the sensors deliver."""
        self._after.sense(measured)

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """Return the recorded command of the step, or a new one.

        Raises:
            UsageError: the recorded one is not given again.
        """
        seq, self._seq = self._seq, self._seq + 1
        answer = self._after.command(estimate)
        if seq >= len(self._recorded):
            return answer
        told = self._recorded[seq]
        if self._same:
            _check_same(f'controller {self.word}', seq, told, answer)
        return told


def _check_same(who: str, seq: int, told: object, answer: object) -> None:
    if repr(told) != repr(answer):  # by repr, NaN equals NaN
        raise UsageError(
            f'fork: {who} answers {answer} at step {seq}, recorded is {told}: the run cannot be '
            'repeated, as by another version, on another processor, or by code that is not '
            'reproducible'
        )
