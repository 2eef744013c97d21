"""What the sensors of a run measure, when, and when it arrives.

Which measurement arrives at which control step follows from the scenario alone
(:class:`Schedule`), so every node knows what to wait for, and silence is no time-out. The noise is
seeded by the start of the run and ``fault_seed``: equal scenes have equal bytes in every layout.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import struct
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, partial
from operator import attrgetter
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.place.runway_frame import MapPose, runway_frame
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CAMERA_OFFSETS, FAULTS
from taxinet_ros.core.sensors import (
    NO_SENSORS,
    Fix,
    Gnss,
    Imu,
    Inertial,
    Measured,
    Picture,
    SecondCamera,
    Sensor,
    Speed,
    WheelSpeed,
)
from taxinet_ros.core.topics import SENSORS
from taxinet_ros.core.traffic.traffic import NOTHING_HELD, Holds
from taxinet_ros.core.types import (
    NS_PER_S,
    AircraftState,
    quaternion,
    rate_of,
    reached_ns,
    step_stamp_ns,
    steps_in,
)
from taxinet_ros.errors import UsageError

GRAVITY_MPS2 = 9.80665
_BLOCK, _DRAWS = 64, 8
_Floats = Sequence[float]
_NUMBERS = tuple(field.name for field in dataclasses.fields(AircraftState))
_values = attrgetter(*_NUMBERS)


class Schedule:
    """Which measurements of a run arrive at which control step."""

    def __init__(self, scenario: Scenario, period_ns: int) -> None:
        """``period_ns``: control period [ns]."""
        self.scenario, self.period_ns = scenario, period_ns
        self.sensors = scenario.sensor_set
        self.hold_lines = scenario.hold_lines
        # From start and seed only: the same for each value of other keys. Zero has one sign.
        start = struct.pack('<4d', *(0.0 + value for value in (
            scenario.cross_track_m, scenario.distance_m, scenario.heading_rad, scenario.fault_seed,
        )))
        self._seed = list(hashlib.sha256(start).digest())
        self._drawn: dict[tuple[str, int], list[list[float]]] = {}

    @property
    def fast(self) -> list[Sensor]:
        """Sensors that need states between control steps."""
        return [one for one in self.sensors.present if rate_of(self.period_ns) % one.rate_hz]

    def due(self, seq: int) -> Iterator[tuple[Sensor, int]]:
        """Sensor and number of each measurement that arrives at a step, in order."""
        return (one for one in self.sent(seq) if not self.lost(*one))

    def sent(self, seq: int) -> Iterator[tuple[Sensor, int]]:
        """As :meth:`due`, with those that are lost on their way."""
        begin_ns, end_ns = (step_stamp_ns(one, self.period_ns) for one in (seq - 1, seq))
        for sensor in self.sensors.present:
            delay_ns = reached_ns(sensor.delay_s)
            for number in sensor.between(begin_ns - delay_ns, end_ns - delay_ns):
                yield sensor, number

    def uncleared_m(self, seq: int) -> tuple[float, ...]:
        """Distances along the track of the hold lines not cleared at a step, ascending [m]."""
        stamp_ns = step_stamp_ns(seq, self.period_ns)
        return tuple(along_m for along_m, until_ns in self.hold_lines if stamp_ns < until_ns)

    def counts(self, seq: int) -> Counter[str]:
        """Number of messages that arrive at a step, by topic."""
        return Counter(SENSORS[sensor.name].name for sensor, _ in self.due(seq))

    def step_of(self, topic: str, stamp_ns: int) -> int:
        """Control step at which the measurement of a time arrives on a topic."""
        delay_ns = next((
            reached_ns(one.delay_s) for one in self.sensors.present
            if SENSORS[one.name].name == topic
        ), 0)
        return steps_in(stamp_ns + delay_ns, self.period_ns)

    def lost(self, sensor: Sensor, number: int) -> bool:
        """Whether a measurement never arrives."""
        share = sensor.loss_fraction
        if share == 1 or sensor.silent(sensor.stamp_ns(number)):
            return True
        return share > 0 and self.noise(sensor, number)[-1] < NormalDist().inv_cdf(share)

    def noise(self, sensor: Sensor, number: int) -> _Floats:
        """Standard normal draws of one measurement; the last one decides if it is lost."""
        block, at = divmod(number, _BLOCK)  # a generator for each would cost more than all else
        rows = self._drawn.get((sensor.name, block))
        if rows is None:
            rng = np.random.default_rng([*self._seed, block, *sensor.name.encode()])
            rows = self._drawn[sensor.name, block] = rng.standard_normal((_BLOCK, _DRAWS)).tolist()
        return rows[at]


class _View:
    """What the second camera sees of one scene; made for its first picture."""

    def __init__(self, scenario: Scenario) -> None:
        camera = scenario.sensor_set.camera
        assert camera is not None
        changes: dict[str, Any] = {offset.attribute: 0.0 for offset in CAMERA_OFFSETS}
        self._scenario = dataclasses.replace(
            scenario.without_sensors().without_faults(*FAULTS), camera=camera.mount.text, **changes)
        self._taken: tuple[int, NDArray[np.uint8]] | None = None

    @cached_property
    def _camera(self) -> Any:
        from taxinet_ros.core.camera.camera import Camera  # nodes that only read messages need none

        return Camera(self._scenario)

    def picture(self, state: AircraftState, stamp_ns: int, held: Holds) -> Picture:
        """The picture of a state, which is rendered when it is looked at.

        Raises:
            ValueError: the camera would be at or below the ground.
        """
        from taxinet_ros.core.camera.camera import pose

        pose(state, self._scenario.camera_model)
        return Picture(stamp_ns=stamp_ns, take=partial(self._take, state, stamp_ns, held))

    def _take(self, state: AircraftState, stamp_ns: int, held: Holds) -> NDArray[np.uint8]:
        # Perception, controller and recorder look at the same one.
        if self._taken is None or self._taken[0] != stamp_ns:
            self._taken = stamp_ns, self._camera.render(state, stamp_ns, held=held)
        return self._taken[1]


class Sensing:
    """The sensors of one run, which follow the aircraft from step to step.

    Attributes:
        fast: whether it needs states between control steps.
        measured: what arrives at the current step.
    """

    def __init__(self, scenario: Scenario, period_ns: int, state: AircraftState) -> None:
        """Measure at the start.

        Args:
            scenario: with the sensors.
            period_ns: control period [ns].
            state: at the start.
        """
        self._schedule = Schedule(scenario, period_ns)
        self.fast = bool(self._schedule.fast)
        self._seq = 0
        self._pending: dict[tuple[str, int], Fix | Inertial | Speed | Picture] = {}
        self._drift_m: _Floats | None = None
        self._held = NOTHING_HELD
        self.change(scenario)
        self._measure(-1, [state, state])
        self.measured = self._arriving()

    def change(self, scenario: Scenario) -> None:
        """Go on in another scene, as the second camera sees it from now on."""
        self._view = None if scenario.sensor_set.camera is None else _View(scenario)

    def advance(self, states: Sequence[AircraftState], held: Holds = NOTHING_HELD) -> None:
        """Measure in a control period.

        Args:
            states: at its begin, evenly spaced between, and at its end.
            held: others on the ground that the aircraft holds at its end.
        """
        self._held = held
        self._measure(step_stamp_ns(self._seq, self._schedule.period_ns), states)
        self._seq += 1
        self.measured = self._arriving()

    def _arriving(self) -> Measured:
        found: dict[str, list[Fix | Inertial | Speed | Picture]] = {}
        for sensor, number in self._schedule.sent(self._seq):
            if (one := self._pending.pop((sensor.name, number), None)) is not None:
                found.setdefault(sensor.name, []).append(one)
        values = {name: tuple(values) for name, values in found.items()}
        # A sensor is named as the field that has its measurements, which mypy cannot know.
        return Measured(**values, hold_lines_m=self._schedule.uncleared_m(self._seq))  # type: ignore[arg-type]

    def _measure(self, begin_ns: int, states: Sequence[AircraftState]) -> None:
        """Measure after ``begin_ns``; before the start at the start alone."""
        period_ns, parts = self._schedule.period_ns, len(states) - 1
        end_ns = step_stamp_ns(self._seq + 1, period_ns) if begin_ns >= 0 else 0
        step_s = period_ns / NS_PER_S / parts
        begin = states[0]  # in one period the meridian turns by less than a millionth of a degree
        if self._schedule.sensors.imu is not None:
            self._east_rad = math.pi / 2 - runway_frame(self._schedule.scenario.runway).to_geodetic(
                MapPose(x_m=begin.x_m, y_m=begin.y_m, z_m=begin.z_m, yaw_rad=0.0)).heading_rad
        for sensor in self._schedule.sensors.present:
            for number in sensor.between(begin_ns, end_ns):
                stamp_ns = sensor.stamp_ns(number)
                at = (stamp_ns - max(begin_ns, 0)) / (end_ns - begin_ns) * parts
                part = max(math.ceil(at), 1)
                pair = states[part - 1], states[part]
                taken = self._take(sensor, number, stamp_ns, pair, at - (part - 1), step_s)
                if not self._schedule.lost(sensor, number):
                    self._pending[sensor.name, number] = taken

    def _take(
        self, sensor: Sensor, number: int, stamp_ns: int,
        pair: tuple[AircraftState, AircraftState], share: float, step_s: float,
    ) -> Fix | Inertial | Speed | Picture:
        """One measurement between two states ``step_s`` apart."""
        noise = self._schedule.noise(sensor, number)
        state = between(*pair, share)
        if isinstance(sensor, Gnss):
            return self._fix(sensor, stamp_ns, state, noise)
        if isinstance(sensor, Imu):
            return self._inertial(sensor, stamp_ns, state, pair, step_s, noise)
        if isinstance(sensor, SecondCamera):
            assert self._view is not None
            return self._view.picture(state, stamp_ns, self._held)  # exposed at control steps
        assert isinstance(sensor, WheelSpeed)
        speed_mps = state.speed_mps * (1 + sensor.bias_percent / 100)
        return Speed(
            stamp_ns=stamp_ns, speed_mps=speed_mps + sensor.noise_mps * noise[0],
            sigma_mps=sensor.noise_mps,
        )

    def _fix(self, gnss: Gnss, stamp_ns: int, state: AircraftState, noise: _Floats) -> Fix:
        # First-order Gauss-Markov process: its standard deviation is 1 from the first sample on.
        keep = math.exp(-gnss.period_ns / NS_PER_S / gnss.correlation_s) if (
            gnss.correlation_s and self._drift_m is not None) else 0.0
        before = self._drift_m or (0.0, 0.0, 0.0)
        fresh = math.sqrt(1 - keep * keep)
        self._drift_m = [keep * old + fresh * new for old, new in zip(before, noise, strict=False)]
        x, y, z = (gnss.noise_m * one for one in self._drift_m)
        scenario = self._schedule.scenario
        at = runway_frame(scenario.runway).to_geodetic(MapPose(
            x_m=state.x_m + x, y_m=state.y_m + y + gnss.bias_m, z_m=state.z_m + z, yaw_rad=0.0,
        ))
        return Fix(
            stamp_ns=stamp_ns, latitude_deg=math.degrees(at.latitude_rad),
            longitude_deg=math.degrees(at.longitude_rad), altitude_m=at.altitude_m,
            sigma_m=gnss.noise_m, runway=scenario.runway, track=scenario.line,
        )

    def _inertial(
        self, imu: Imu, stamp_ns: int, state: AircraftState,
        pair: tuple[AircraftState, AircraftState], step_s: float, noise: _Floats,
    ) -> Inertial:
        before, after = pair
        rolling, pitching, ahead = (
            (getattr(after, name) - getattr(before, name)) / step_s
            for name in ('roll_rad', 'pitch_rad', 'speed_mps')
        )
        rates = (rolling, pitching, state.yaw_rate_radps + imu.yaw_rate_bias_radps)
        # Specific force of a body that rolls on level ground; it pitches and rolls little.
        force = (
            ahead - GRAVITY_MPS2 * math.sin(state.pitch_rad) + imu.acceleration_bias_mps2,
            state.speed_mps * state.yaw_rate_radps + GRAVITY_MPS2 * math.sin(state.roll_rad),
            GRAVITY_MPS2 * math.cos(state.pitch_rad) * math.cos(state.roll_rad),
        )
        yaw_rad = (
            self._east_rad + state.yaw_rad + imu.heading_bias_rad + imu.heading_noise_rad * noise[6]
        )
        gyro, accelerometer = imu.yaw_rate_noise_radps, imu.acceleration_noise_mps2
        return Inertial(
            stamp_ns=stamp_ns,
            rates_radps=(
                rates[0] + gyro * noise[0], rates[1] + gyro * noise[1], rates[2] + gyro * noise[2]),
            acceleration_mps2=(
                force[0] + accelerometer * noise[3], force[1] + accelerometer * noise[4],
                force[2] + accelerometer * noise[5]),
            orientation=quaternion(state.roll_rad, state.pitch_rad, yaw_rad),
            sigmas=imu.sigmas,
        )


def between(before: AircraftState, after: AircraftState, share: float) -> AircraftState:
    """State between two others that are 8 ms apart, or a control period; the later one at 1."""
    if share == 1.0:
        return after
    turned = math.remainder(after.yaw_rad - before.yaw_rad, math.tau)
    values = {
        name: one + share * (other - one)
        for name, one, other in zip(_NUMBERS, _values(before), _values(after), strict=True)
    }
    values['yaw_rad'] = before.yaw_rad + share * turned
    return AircraftState(**values)


def measured_of(schedule: Schedule, seq: int, messages: Mapping[str, Sequence[Any]]) -> Measured:
    """What messages of a step say, bit for bit what the sensors measured.

    Args:
        schedule: of the run.
        seq: the step.
        messages: decoded messages by sensor, oldest first.
    """
    sensors, scenario = schedule.sensors, schedule.scenario
    gnss, imu, wheel = sensors.gnss, sensors.imu, sensors.wheel
    return Measured(
        gnss=tuple(
            Fix(
                stamp_ns=_stamp_ns(one), latitude_deg=one.latitude, longitude_deg=one.longitude,
                altitude_m=one.altitude, sigma_m=gnss.noise_m, runway=scenario.runway,
                track=scenario.line,
            ) for one in messages.get('gnss', ())
        ) if gnss else (),
        imu=tuple(
            Inertial(
                stamp_ns=_stamp_ns(one), rates_radps=_xyz(one.angular_velocity),
                acceleration_mps2=_xyz(one.linear_acceleration),
                orientation=(*_xyz(one.orientation), one.orientation.w), sigmas=imu.sigmas,
            ) for one in messages.get('imu', ())
        ) if imu else (),
        wheel=tuple(
            Speed(
                stamp_ns=_stamp_ns(one), speed_mps=one.twist.twist.linear.x,
                sigma_mps=wheel.noise_mps,
            ) for one in messages.get('wheel', ())
        ) if wheel else (),
        camera=tuple(
            Picture(stamp_ns=_stamp_ns(one), take=partial(_pixels, one))
            for one in messages.get('camera', ())
        ),
        hold_lines_m=schedule.uncleared_m(seq),
    )


def _pixels(message: Any) -> NDArray[np.uint8]:
    return np.asarray(message.data, np.uint8).reshape(message.height, message.width, 3).view()


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * NS_PER_S + int(message.header.stamp.nanosec)


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def sensing_of(scenario: Scenario, period_ns: int, state: AircraftState) -> Sensing | None:
    """What a scenario's sensors and tower tell; None without sensors and hold lines.

    Arguments as for :class:`Sensing`.
    """
    silent = scenario.sensors == NO_SENSORS and not scenario.others.hold_lines
    return None if silent else Sensing(scenario, period_ns, state)


def check_rates(scenario: Scenario, period_ns: int, who: str) -> None:
    """Refuse sensors that need states between control steps, and a second camera.

    Raises:
        UsageError: there is one.
    """
    scenario.sensor_set.refuse_camera(who)
    for sensor in Schedule(scenario, period_ns).fast:
        raise UsageError(
            f'sensors: {sensor.name}.rate_hz is {sensor.rate_hz}, but {who} gives its state '
            f'{rate_of(period_ns)} times a second; take a divisor of that'
        )
