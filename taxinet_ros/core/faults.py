"""Faults of sensors, computers and actuators: from when they hold, and what they do to a step.

Each is a pure function of the scenario and simulated time, or of the commands so far, so every
layout of a run, and a re-simulation, has the same ones. What they do to the light of a picture is
in :mod:`taxinet_ros.core.camera.lens_faults`.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    CONTROL_RATE,
    LOOP_DELAY,
    LOOP_JITTER,
    PICTURE_FAULTS,
    STEERING_BIAS,
)
from taxinet_ros.core.sensors import NO_SENSORS
from taxinet_ros.core.traffic.traffic import HOLD_LINE
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, reached_ns, steps_in
from taxinet_ros.errors import UsageError


def unseen_faults(scenario: Scenario) -> list[str]:
    """A warning if a perception that needs no picture cannot notice some of the faults."""
    keys = [field.key for field in scenario.faults if field in PICTURE_FAULTS]
    return [f'{", ".join(keys)}: no effect, as the perception needs no picture'] if keys else []


def check_free(scenario: Scenario) -> None:
    """Refuse what a free run cannot have.

    Raises:
        UsageError: the scenario delays the loop, or has sensors, hold lines or another control
            rate.
    """
    if scenario.control_rate_hz != CONTROL_RATE.absent:
        raise UsageError(f'{CONTROL_RATE.key}: not in a free run, whose pace is that of 10 Hz')
    if scenario.sensors != NO_SENSORS:
        raise UsageError('sensors: not in a free run, where what a step waits for is not known')
    if scenario.others.hold_lines:
        raise UsageError(
            f'traffic: no {HOLD_LINE} in a free run, where what a step waits for is not known'
        )
    if not {LOOP_DELAY, LOOP_JITTER}.isdisjoint(scenario.faults):
        raise UsageError(
            'loop_delay_s, loop_jitter_s: no effect in a free run, which has real delays'
        )


def begun(scenario: Scenario, stamp_ns: int) -> bool:
    """Whether the scenario's faults hold at a simulated time."""
    return stamp_ns >= reached_ns(scenario.fault_onset_s)


def frame_lost(scenario: Scenario, stamp_ns: int) -> bool:
    """Whether the camera frame of a simulated time is lost."""
    share = scenario.camera_dropout_fraction
    return share > 0 and begun(scenario, stamp_ns) and _chance(scenario, 'lost', stamp_ns) < share


def shown_step(scenario: Scenario, seq: int, period_ns: int) -> int:
    """Step whose picture the camera delivers at step ``seq``: that of the onset, while frozen."""
    onset = steps_in(reached_ns(scenario.fault_onset_s), period_ns)
    repeats = steps_in(reached_ns(scenario.camera_freeze_s), period_ns)
    return onset if onset < seq <= onset + repeats else seq


def loop_delay_ns(scenario: Scenario, stamp_ns: int) -> int:
    """Additional time [ns] until the answer to the frame of a simulated time takes effect."""
    delay_s: float = scenario.at(LOOP_DELAY, stamp_ns)
    jitter_s = scenario.loop_jitter_s
    if not (delay_s or jitter_s) or not begun(scenario, stamp_ns):
        return 0
    if jitter_s:
        delay_s += jitter_s * _chance(scenario, 'jitter', stamp_ns)
    return reached_ns(delay_s)


def _chance(scenario: Scenario, name: str, stamp_ns: int) -> float:
    """Uniform draw, 0..1, of a fault at a simulated time."""
    draws = np.random.default_rng([int(scenario.fault_seed), stamp_ns, *name.encode()])
    return float(draws.random())


class SteeringFaults:
    """The nose wheel of one run between command and aircraft: biased, or too slow."""

    def __init__(
        self, scenario: Scenario, max_steering_rad: float, period_ns: int, wheel_rad: float = 0.0
    ) -> None:
        """Begin straight ahead, or where the wheel is.

        Args:
            scenario: with the faults.
            max_steering_rad: largest angle of the wheel [rad].
            period_ns: control period [ns].
            wheel_rad: angle of the wheel until now [rad].
        """
        self._scenario, self._max_rad = scenario, max_steering_rad
        self._biased = scenario.ever(STEERING_BIAS)
        rate_radps = scenario.steering_rate_limit_radps
        self._max_step_rad = rate_radps * period_ns / NS_PER_S
        self._wheel_rad = _clip(wheel_rad, max_steering_rad)

    def apply(self, command: TaxiCommand, stamp_ns: int) -> TaxiCommand:
        """What the aircraft obeys from ``stamp_ns`` on; call once per step, in order."""
        if not (self._biased or self._max_step_rad):
            return command
        told_rad = _clip(command.steering_rad, self._max_rad)
        if not begun(self._scenario, stamp_ns):
            self._wheel_rad = told_rad
            return command
        bias_rad = self._scenario.at(STEERING_BIAS, stamp_ns)
        wheel_rad = _clip(told_rad + bias_rad, self._max_rad)
        if self._max_step_rad:
            wheel_rad = self._wheel_rad + _clip(wheel_rad - self._wheel_rad, self._max_step_rad)
        self._wheel_rad = wheel_rad
        return dataclasses.replace(command, steering_rad=wheel_rad)


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
