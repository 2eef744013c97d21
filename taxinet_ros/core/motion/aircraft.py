"""Taxiing aircraft: JSBSim, advanced one control period at a time, with a speed hold.

The scenario sets wind, gusts, runway friction and slope.
"""

from __future__ import annotations

import math
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from statistics import fmean

import jsbsim

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.gusts import Gusts
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.runway_frame import GeodeticPose, MapPose, runway_frame
from taxinet_ros.core.rig.aircraft_model import (
    USUAL_SPEED_MPS,
    AircraftModel,
    Attitude,
    SpeedGains,
)
from taxinet_ros.core.rig.model_files import write_model_files
from taxinet_ros.core.scenario import Scenario, check_camera_height
from taxinet_ros.core.scenario_fields import GUST, WIND_DIRECTION, WIND_SPEED
from taxinet_ros.core.signals import kept_signals
from taxinet_ros.core.types import FOOT_M, NS_PER_S, AircraftState, TaxiCommand
from taxinet_ros.errors import InfraError, InfraKind, UsageError


class CapturedLog(jsbsim.FGLogger):
    """Collects JSBSim's log.

    Attributes:
        text: log so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.text = ''

    def set_level(self, level: jsbsim.LogLevel) -> None:
        """Ignore the severity of the next record."""

    def file_location(self, filename: str, line: int) -> None:
        """Ignore the source location of the next record."""

    def message(self, message: str) -> None:
        """Append a piece of text."""
        self.text += message

    def format(self, style: jsbsim.LogFormat) -> None:
        """Ignore colours."""

    def flush(self) -> None:
        """End a record."""
        self.text += '\n'


@contextmanager
def captured_log() -> Iterator[CapturedLog]:
    """Capture JSBSim's log on this thread within the context."""
    outer = jsbsim.get_logger()
    log = CapturedLog()
    jsbsim.set_logger(log)
    try:
        yield log
    finally:
        jsbsim.set_logger(outer)


class SpeedHold:
    """PI control of the ground speed; speed 0 closes the lever and applies full brakes."""

    def __init__(self, gains: SpeedGains) -> None:
        """Start in equilibrium: the lever holds a steady roll."""
        self._gains = gains
        self._integral = gains.rolling_lever

    def update(self, wanted_mps: float, actual_mps: float, dt_s: float) -> tuple[float, float]:
        """Lever and brake, each 0..1, for the next ``dt_s`` seconds.

        Args:
            wanted_mps: speed to hold [m/s]; 0 stops the aircraft.
            actual_mps: ground speed along the body x axis [m/s].
            dt_s: time until the next update [s].
        """
        if wanted_mps == 0:
            self._integral = self._gains.rolling_lever
            return 0.0, 1.0
        missing_mps = wanted_mps - actual_mps
        # Anti-windup: limit the integral to the lever's range.
        integral = self._integral + self._gains.lever_per_m * missing_mps * dt_s
        self._integral = min(max(integral, 0.0), 1.0)
        lever = self._integral + self._gains.lever_per_mps * missing_mps
        brake = -lever * self._gains.brake_per_lever
        return min(max(lever, 0.0), 1.0), min(max(brake, 0.0), 1.0)


PHYSICS_HZ = 120
TAXI_SPEED_MPS = USUAL_SPEED_MPS
"""Default ground speed of a scenario [m/s]."""
FRICTION = {'dry': 1.0, 'wet': 0.7, 'icy': 0.0625}
"""Tyre friction, lateral and in braking, relative to dry pavement.

Wet: 14 CFR 25.109(d)(1), a grooved wet runway has 70 percent of the dry braking coefficient. Icy:
EASA AMC 25.1591 gives 0.05 for ice; the models have 0.8 on dry pavement.
"""
_ALL = -1  # JSBSim's index for every engine
_OUTPUTS = (
    'position/lat-geod-rad',
    'position/long-gc-rad',
    'position/geod-alt-ft',
    'attitude/phi-rad',
    'attitude/theta-rad',
    'attitude/psi-rad',
    'velocities/u-fps',
    'velocities/psidot-rad_sec',
)


def _adapted(models: Path, name: str, scratch: Path, *, windy: bool, sloping: bool) -> Path:
    """Write a copy of a model extended for wind or slope; return its models folder.

    A loaded model cannot be extended, and the extensions would slow down all runs.

    Args:
        models: folder of model folders.
        name: name of the model.
        scratch: folder to write to, which is returned.
        windy: add the aerodynamics of ``wind.xml`` from the model's folder.
        sloping: add a force set by :func:`_pull_down`, since JSBSim's ground is level and its
            gravity vertical.
    """
    tree = ET.parse(models / name / f'{name}.xml')
    root = tree.getroot()
    wind = models / name / 'wind.xml'
    for axis in ET.parse(wind).getroot() if windy and wind.is_file() else ():
        there = root.find(f'aerodynamics/axis[@name="{axis.get("name")}"]')
        assert there is not None, f'{wind}: {axis.get("name")} is no axis of {name}'
        there.extend(axis)
    if sloping:
        forces = root.find('external_reactions')
        if forces is None:
            forces = ET.SubElement(root, 'external_reactions')
        force = ET.SubElement(forces, 'force', name='slope', frame='LOCAL')
        ET.SubElement(force, 'location', unit='IN')
        ET.SubElement(force, 'direction')
        for part in force:
            for letter in 'xyz':
                ET.SubElement(part, letter).text = '0'
    folder = scratch / name
    folder.mkdir(exist_ok=True)
    for beside in (models / name).iterdir():  # engines and systems of its own, if it has any
        if not (folder / beside.name).exists():
            (folder / beside.name).symlink_to(beside)
    main = folder / f'{name}.xml'
    main.unlink()
    tree.write(main)
    return scratch


def _pull_down(fdm: jsbsim.FGFDMExec, slope_rad: float, along_rad: float) -> None:
    """Apply gravity's component along a sloping runway at the centre of gravity.

    Args:
        fdm: JSBSim with a model of :func:`_adapted`.
        slope_rad: slope of the runway, uphill positive [rad].
        along_rad: true heading uphill [rad].
    """
    # Neglected: the wheel load drops by 1 - cos, at most 0.1 %.
    for axis in 'xyz':
        fdm[f'external_reactions/slope/location-{axis}-in'] = fdm[f'inertia/cg-{axis}-in']
    fdm['external_reactions/slope/x'] = -math.cos(along_rad)
    fdm['external_reactions/slope/y'] = -math.sin(along_rad)
    fdm['external_reactions/slope/magnitude'] = fdm['inertia/weight-lbs'] * math.sin(slope_rad)


_WIND = (WIND_SPEED, WIND_DIRECTION, GUST)


def _wind_values(scenario: Scenario) -> tuple[float | str, ...]:
    return (
        scenario.wind_speed_mps, scenario.wind_direction_rad, scenario.gust_mps, scenario.gust_seed,
        kept_signals(scenario.signals, _WIND),
    )


class Wind:
    """Wind of a scenario: steady, or with :class:`.Gusts`.

    Attributes:
        steady: whether it has no gusts.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Compute the wind vector at the start."""
        self._scenario = scenario
        self.steady = not scenario.ever(GUST)
        self._gusts = Gusts(scenario.gust_mps, int(scenario.gust_seed))
        self._now = self._at(0)
        self._values = _wind_values(scenario)

    def _at(self, stamp_ns: int) -> tuple[float, float]:
        """Mean wind to the north and to the east; its gusts follow."""
        speed_mps, from_rad, self._gusts.sigma_mps = (
            self._scenario.at(field, stamp_ns) for field in _WIND
        )
        return -speed_mps * math.cos(from_rad), -speed_mps * math.sin(from_rad)

    def is_of(self, scenario: Scenario) -> bool:
        """Whether a scenario has this wind."""
        return self._values == _wind_values(scenario)

    def begin(self, fdm: jsbsim.FGFDMExec) -> None:
        """Set the mean wind in JSBSim."""
        north_mps, east_mps = self._now
        fdm['atmosphere/wind-north-fps'] = north_mps / FOOT_M
        fdm['atmosphere/wind-east-fps'] = east_mps / FOOT_M

    def follow(self, fdm: jsbsim.FGFDMExec, stamp_ns: int) -> None:
        """Set the wind of a simulated time, where it changes; the gusts go on."""
        before, self._now = self._now, self._at(stamp_ns)
        if self._now != before:
            self.begin(fdm)

    def gusts(self, fdm: jsbsim.FGFDMExec, steps: int) -> Iterator[None]:
        """Set the gust at the aircraft's position before each of ``steps`` physics steps."""
        north_mps, east_mps = (
            fdm[f'velocities/v-{way}-fps'] * FOOT_M - wind_mps
            for way, wind_mps in zip(('north', 'east'), self._now, strict=True)
        )
        way_mps = math.hypot(north_mps, east_mps)
        # The specification aligns its axes with the mean relative wind; without one (at rest in
        # still air) the axes are arbitrary.
        north, east = (north_mps / way_mps, east_mps / way_mps) if way_mps else (1.0, 0.0)
        for _ in range(steps):
            along, across = self._gusts.along_mps, self._gusts.across_mps
            fdm['atmosphere/gust-north-fps'] = (along * north - across * east) / FOOT_M
            fdm['atmosphere/gust-east-fps'] = (along * east + across * north) / FOOT_M
            yield
            self._gusts.advance(way_mps / PHYSICS_HZ)


@dataclass(frozen=True, slots=True)
class Placed:
    """Where an aircraft is placed, rolling straight in the attitude in which it taxis.

    Attributes:
        x_m, y_m, yaw_rad: pose in ``map`` [m, m, rad].
        speed_mps: ground speed [m/s].
    """

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float


class Aircraft:
    """Aircraft of one run; starts at the scenario's pose and speed.

    Attributes:
        model: its model, including measured values.
        max_steering_rad: largest nose-wheel angle [rad]; commands are clipped to it.
        traced: whether to keep the states of each period.
        states: at the begin of the last period and after each of its physics steps, if traced.
    """

    traced = False

    def __init__(
        self, scenario: Scenario, *, model: AircraftModel | None = None,
        runway: Runway | None = None, placed: Placed | None = None,
    ) -> None:
        """Load a model and place it on the runway.

        Args:
            scenario: start pose, aircraft model and control rate.
            model: replaces the scenario's model.
            runway: replaces the scenario's runway.
            placed: replaces the scenario's start pose and speed.

        Raises:
            InfraError: JSBSim cannot load or start the model.
            UsageError: the model is incomplete and cannot be measured.
        """
        self._steps = round(PHYSICS_HZ / scenario.control_rate_hz)
        self._period_s = scenario.period_ns / NS_PER_S
        self._step = -1
        self._frame = runway_frame(runway or scenario.runway)
        own, self.model = model is None, model or scenario.aircraft_model
        if self.model.settled is None or self.model.speed_gains is None:
            self.model = measured_model(self.model)
            if own:
                for camera in scenario.cameras:
                    check_camera_height(camera, self.model)
        model = self.model
        assert model.settled is not None
        assert model.speed_gains is not None
        self._settled, self._gains = model.settled, model.speed_gains
        self._hold = SpeedHold(self._gains)
        self._wind = Wind(scenario) if scenario.windy else None
        self._fdm = self._load(model.model, scenario=scenario)
        self._friction = FRICTION[scenario.surface]
        self._full_steering_rad = full_steering_rad(model)
        self.max_steering_rad = model.max_steering_rad or self._full_steering_rad
        if placed is None:
            at = scenario.line.pose(
                scenario.distance_m, scenario.cross_track_m, scenario.heading_rad
            )
            placed = Placed(*at, speed_mps=scenario.speed_mps)
        along_rad = self._place(placed)
        self._start_rolling(scenario, along_rad)
        self._step = 0
        self._state = self._measure()

    @property
    def state(self) -> AircraftState:
        """Current pose and motion in ``map``."""
        return self._state

    def advance(self, command: TaxiCommand) -> AircraftState:
        """Integrate one control period with constant nose wheel, lever and brakes.

        Args:
            command: nose-wheel angle, clipped to :attr:`max_steering_rad`, and speed to hold.

        Returns:
            The state at the end of the period.

        Raises:
            ValueError: the command is not finite, or its speed is negative.
            InfraError: JSBSim failed, the state is no longer finite, or the aircraft flies.
        """
        if not (math.isfinite(command.steering_rad) and 0 <= command.speed_mps < math.inf):
            raise ValueError(f'not a command that an aircraft can follow: {command}')
        self._set_controls(command)
        self._step += 1
        self._attempt(self._integrate, 'run')
        self._state = self._measure()
        return self._state

    def change(self, scenario: Scenario) -> None:
        """Roll on in the wind and with the friction of another scene.

        Args:
            scenario: the scene. Whether it has wind has to be as before, as the model of windy air
                is another.
        """
        if (self._wind is None) is scenario.windy:
            raise ValueError('wind cannot come up or die down, as the loaded model is another then')
        if self._wind is not None and not self._wind.is_of(scenario):
            self._wind = Wind(scenario)
            self._wind.begin(self._fdm)
            self._fdm['atmosphere/gust-north-fps'] = self._fdm['atmosphere/gust-east-fps'] = 0.0
        self._set_friction(scenario.surface)

    def follow(self, scenario: Scenario, stamp_ns: int) -> None:
        """Set wind and friction of a simulated time, in a scene where they change."""
        if self._wind is not None:
            self._wind.follow(self._fdm, stamp_ns)
        self._set_friction(scenario.surface_at(stamp_ns))

    def _set_friction(self, surface: str) -> None:
        if (friction := FRICTION[surface]) != self._friction:
            self._fdm['ground/static-friction-factor'] = self._friction = friction

    def _integrate(self) -> bool:
        run = self._fdm.run
        if self.traced:
            self.states = [self._state]
            run = self._run_traced
        if self._wind is None or self._wind.steady:
            return all(run() for _ in range(self._steps))
        return all(run() for _ in self._wind.gusts(self._fdm, self._steps))

    def _run_traced(self) -> bool:
        done: bool = self._fdm.run()
        if done:
            self.states.append(self._measure())
        return done

    def _load(self, name: str, *, scenario: Scenario) -> jsbsim.FGFDMExec:
        with captured_log() as log, ExitStack() as used:
            fdm = jsbsim.FGFDMExec(None)
            fdm.set_debug_level(0)
            folder = self.model.folder
            windy, sloping = self._wind is not None, bool(scenario.slope_fraction)
            if self.model.files or windy or sloping:  # else no folder is written
                scratch = Path(used.enter_context(tempfile.TemporaryDirectory()))
            if self.model.files:
                folder = write_model_files(scratch, name, self.model.files)
            if windy or sloping:
                models = folder or Path(fdm.get_aircraft_path())
                folder = _adapted(models, name, scratch, windy=windy, sloping=sloping)
            if folder is not None:
                fdm.set_aircraft_path(str(folder))
            self._attempt(lambda: fdm.load_model(name), f'loading {name}', log)
        fdm.set_dt(1 / PHYSICS_HZ)
        return fdm

    def _place(self, placed: Placed) -> float:
        """Set the initial pose; return the runway's true heading there [rad]."""
        yaw_rad = placed.yaw_rad
        pose = self._frame.to_geodetic(
            MapPose(x_m=placed.x_m, y_m=placed.y_m, z_m=self._settled.z_m, yaw_rad=yaw_rad)
        )
        fdm = self._fdm
        # Order matters: terrain before height above it, attitude before speeds.
        fdm['ic/terrain-elevation-ft'] = self._frame.elevation_m / FOOT_M
        fdm['ic/lat-geod-rad'] = pose.latitude_rad
        fdm['ic/long-gc-rad'] = pose.longitude_rad
        fdm['ic/h-agl-ft'] = self._settled.z_m / FOOT_M
        fdm['ic/psi-true-rad'] = pose.heading_rad
        fdm['ic/theta-rad'] = -self._settled.pitch_rad
        fdm['ic/phi-rad'] = self._settled.roll_rad
        # Parallel to the ground, not along the tilted body axis: the aircraft would sink.
        fdm['ic/vn-fps'] = placed.speed_mps * math.cos(pose.heading_rad) / FOOT_M
        fdm['ic/ve-fps'] = placed.speed_mps * math.sin(pose.heading_rad) / FOOT_M
        fdm['ic/vd-fps'] = 0.0
        return pose.heading_rad + yaw_rad

    def _start_rolling(self, scenario: Scenario, along_rad: float) -> None:
        fdm, lever = self._fdm, self._gains.rolling_lever
        self._attempt(fdm.run_ic, 'run_ic')
        # Only now: initialisation would reset wind and slope.
        if self._wind is not None:
            self._wind.begin(fdm)
        if self._friction != FRICTION['dry']:
            fdm['ground/static-friction-factor'] = self._friction
        if scenario.slope_fraction:
            _pull_down(fdm, math.atan(scenario.slope_fraction), along_rad)
        propulsion = fdm.get_propulsion()
        if not propulsion.get_num_engines():  # the caravan's thrust is an external force
            return
        # Starting an engine also opens its throttle and leaves it at full speed. One step with
        # motion frozen passes the lever to the engine, which then settles at that speed.
        fdm['propulsion/set-running'] = _ALL
        fdm['fcs/throttle-cmd-norm'] = lever
        fdm['simulation/models/FGPropagate/enabled'] = 0
        self._attempt(fdm.run, 'run')
        propulsion.get_steady_state()
        fdm['simulation/models/FGPropagate/enabled'] = 1

    def _set_controls(self, command: TaxiCommand) -> None:
        limit = self.max_steering_rad
        steering_rad = min(max(command.steering_rad, -limit), limit)
        lever, brake = self._hold.update(command.speed_mps, self._state.speed_mps, self._period_s)
        # JSBSim's nose wheel is right positive.
        self._fdm['fcs/steer-cmd-norm'] = -steering_rad / self._full_steering_rad
        self._fdm['fcs/throttle-cmd-norm'] = lever
        self._fdm['fcs/left-brake-cmd-norm'] = brake
        self._fdm['fcs/right-brake-cmd-norm'] = brake

    def _attempt(
        self, action: Callable[[], bool], name: str, log: CapturedLog | None = None
    ) -> None:
        """Call JSBSim; it signals failure by an exception, or by False and a log line."""
        try:
            done = action()
        except RuntimeError as error:
            raise self._failure(f'JSBSim, {name}: {error}') from error
        if not done:
            reason = ' '.join(log.text.split())[-200:] if log else 'no reason given'
            raise self._failure(f'JSBSim, {name}: {reason}')

    def _measure(self) -> AircraftState:
        read = {name: self._fdm[name] for name in _OUTPUTS}
        if not all(map(math.isfinite, read.values())):
            raise self._failure(f'JSBSim is not finite: {read}')
        lifted_m = self._fdm['position/h-agl-ft'] * FOOT_M - self._settled.z_m
        if lifted_m > _MOST_LIFTED_M:
            raise self._failure(
                f'{self.model.name} is {lifted_m:.1f} m above its wheels: the wind lifts it, which '
                'is no taxiing; limit it by most_wind_mps in the file of the aircraft'
            )
        pose = self._frame.to_map(
            GeodeticPose(
                latitude_rad=read['position/lat-geod-rad'],
                longitude_rad=read['position/long-gc-rad'],
                altitude_m=read['position/geod-alt-ft'] * FOOT_M,
                heading_rad=read['attitude/psi-rad'],
            )
        )
        # In JSBSim y is right and z down: pitch is nose up positive, yaw rate clockwise positive.
        return AircraftState(
            x_m=pose.x_m,
            y_m=pose.y_m,
            z_m=pose.z_m,
            roll_rad=read['attitude/phi-rad'],
            pitch_rad=-read['attitude/theta-rad'],
            yaw_rad=pose.yaw_rad,
            speed_mps=read['velocities/u-fps'] * FOOT_M,
            yaw_rate_radps=-read['velocities/psidot-rad_sec'],
        )

    def _failure(self, detail: str) -> InfraError:
        return InfraError(InfraKind.SIM, 'simulator', self._step, detail)


@lru_cache(maxsize=16)
def full_steering_rad(model: AircraftModel) -> float:
    """Full deflection of the nose or tail wheel of a model [rad].

    Raises:
        UsageError: no wheel steers, or less than the aircraft's limit.
    """
    if model.files:
        root = ET.fromstring(dict(model.files)[f'{model.model}.xml'])
    else:
        folder = model.folder or Path(jsbsim.FGFDMExec(None).get_aircraft_path())
        root = ET.parse(folder / model.model / f'{model.model}.xml').getroot()
    angles = [
        abs(float(one.text or 0)) * (1.0 if one.get('unit') == 'RAD' else math.pi / 180)
        for one in root.iter('max_steer')
    ]
    full_rad = max((angle for angle in angles if angle < _CASTORING_RAD), default=0.0)
    if not full_rad:
        raise UsageError(f'aircraft {model.name}: no wheel of the model {model.model} steers')
    limit_rad = model.max_steering_rad or full_rad
    if limit_rad > full_rad * (1 + 1e-9):
        raise UsageError(
            f'aircraft {model.name}: max_steering_deg is {math.degrees(limit_rad):g}, but the '
            f'wheel of the model turns to {math.degrees(full_rad):g} deg at most'
        )
    return full_rad


_CASTORING_RAD = math.radians(359.0)
_GUESSED_GAINS = SpeedGains(
    lever_per_mps=0.2, lever_per_m=0.02, brake_per_lever=1.0, rolling_lever=0.0
)
_SETTLE_S, _RESPONSE_S, _TURN_S = 40, 6, 6
_TRIAL_LEVER = 0.25
_SPEED_RATE_RADPS = 0.5
"""Bandwidth of the speed hold of measured models, below that of propellers and turbines."""
_BRAKING_MPS2 = 3.5
"""Typical deceleration with full brakes on dry pavement."""
_LOOSEST_MPS = 0.5
_LEAST_TURN_RAD = math.radians(0.5)
_MOST_LIFTED_M = 0.5
_MOST_OFF_M, _MOST_OFF_DEG = 0.05, 1.0


def checked_aircraft(model: AircraftModel) -> AircraftModel:
    """Load and test a model; return it with measured values for what its document leaves out.

    Raises:
        UsageError: JSBSim cannot load it, it cannot taxi, or its runs are not reproducible.
    """
    try:
        complete = Aircraft(Scenario(), model=model).model
        if complete is model:  # nothing was measured
            _check_settled(model, _driven(model, _SETTLE_S)[0])
            _check_turn(model)
        return complete
    except InfraError as error:
        raise _unusable(model, error) from None


@lru_cache(maxsize=16)
def measured_model(model: AircraftModel) -> AircraftModel:
    """Measure the attitude and the speed hold that a model's document leaves out.

    JSBSim simulates straight taxiing until it has settled, in about a second. Reproducible.

    Raises:
        UsageError: the model does not load, hold the taxi speed or turn.
    """
    try:
        settled = model.settled or _rough_attitude(model)
        trial = replace(model, settled=settled, speed_gains=_GUESSED_GAINS)
        if model.settled is None:
            trial = replace(trial, settled=_driven(trial, _SETTLE_S)[0])
        gains = model.speed_gains or _response(trial)
        settled, lever, speeds = _driven(replace(trial, speed_gains=gains), _SETTLE_S)
        loose_mps = max(abs(speed - TAXI_SPEED_MPS) for speed in speeds)
        if loose_mps > _LOOSEST_MPS:
            raise UsageError(
                f'aircraft {model.name}: does not hold {TAXI_SPEED_MPS:g} m/s, it rolls at '
                f'{min(speeds):.1f} to {max(speeds):.1f} m/s; set speed_hold'
            )
        if model.speed_gains is None:
            gains = replace(gains, rolling_lever=round(lever, 4))
        _check_settled(model, settled)
        found = replace(model, settled=model.settled or settled, speed_gains=gains)
        _check_turn(found)
    except InfraError as error:
        raise _unusable(model, error) from None
    return found


def _unusable(model: AircraftModel, error: InfraError) -> UsageError:
    doubt = ' (is it at rest with the values of settled?)' if model.settled else ''
    return UsageError(f'aircraft {model.name}: {error.detail}{doubt}')


def _check_settled(model: AircraftModel, driven: Attitude) -> None:
    """Refuse a stated attitude other than that in which it taxis."""
    stated = model.settled
    if stated is None:
        return
    off_deg = math.degrees(max(
        abs(stated.pitch_rad - driven.pitch_rad), abs(stated.roll_rad - driven.roll_rad)
    ))
    if abs(stated.z_m - driven.z_m) > _MOST_OFF_M or off_deg > _MOST_OFF_DEG:
        raise UsageError(
            f'aircraft {model.name}: settled is not how it taxis, which is '
            f'{{height_m: {driven.z_m:.3f}, pitch_deg: {math.degrees(driven.pitch_rad):.2f}, '
            f'roll_deg: {math.degrees(driven.roll_rad):.2f}}}; leave it out to have it measured'
        )


def _rough_attitude(model: AircraftModel) -> Attitude:
    """The height at which the wheels touch the ground, by bisection."""
    low_m, high_m = 0.0, 30.0
    while high_m - low_m > 0.01:
        z_m = (low_m + high_m) / 2
        at = Attitude(z_m=z_m, pitch_rad=0.0, roll_rad=0.0)
        trial = replace(model, settled=at, speed_gains=_GUESSED_GAINS)
        aircraft = Aircraft(Scenario(), model=trial)
        if aircraft._fdm['gear/wow']:
            low_m = z_m
        else:
            high_m = z_m
    return Attitude(z_m=high_m, pitch_rad=0.0, roll_rad=0.0)


def _driven(model: AircraftModel, duration_s: int) -> tuple[Attitude, float, list[float]]:
    """Simulate straight taxiing.

    Returns:
        Mean attitude and mean lever of the last quarter, and the speeds in it [m/s].
    """
    aircraft = Aircraft(Scenario(), model=model)
    steps = duration_s * NS_PER_S // CONTROL_PERIOD_NS
    states, levers = [], []
    for _ in range(steps):
        now = aircraft.state
        steering_rad = -(0.8 * now.yaw_rad + 0.05 * now.y_m)
        states.append(
            aircraft.advance(TaxiCommand(steering_rad=steering_rad, speed_mps=TAXI_SPEED_MPS))
        )
        levers.append(aircraft._fdm['fcs/throttle-cmd-norm'])
    last = states[-(steps // 4):]
    mean = Attitude(
        z_m=round(fmean(state.z_m for state in last), 5),
        pitch_rad=fmean(state.pitch_rad for state in last),
        roll_rad=fmean(state.roll_rad for state in last),
    )
    return mean, fmean(levers[-len(last):]), [state.speed_mps for state in last]


def _response(model: AircraftModel) -> SpeedGains:
    """Derive gains from the acceleration at a constant lever position."""
    def speed_after(lever: float) -> float:
        constant = replace(_GUESSED_GAINS, lever_per_mps=0.0, lever_per_m=0.0, rolling_lever=lever)
        return _driven(replace(model, speed_gains=constant), _RESPONSE_S)[2][-1]

    per_lever = (speed_after(_TRIAL_LEVER) - speed_after(0.0)) / (_RESPONSE_S * _TRIAL_LEVER)
    if per_lever < 0.05:
        raise UsageError(
            f'aircraft {model.name}: its engine does not move it, or does not run at idle'
        )
    gain = round(_SPEED_RATE_RADPS / per_lever, 4)
    return SpeedGains(
        lever_per_mps=gain, lever_per_m=round(gain / 10, 4),
        brake_per_lever=round(min(per_lever / _BRAKING_MPS2, 2.0), 4), rolling_lever=0.0,
    )


def _check_turn(model: AircraftModel) -> None:
    """Refuse a model that its wheel does not steer, or whose runs are not reproducible."""
    aircraft, again = (Aircraft(Scenario(), model=model) for _ in range(2))
    command = TaxiCommand(
        steering_rad=min(aircraft.max_steering_rad / 2, math.radians(10.0)),
        speed_mps=TAXI_SPEED_MPS,
    )
    for _ in range(_TURN_S * NS_PER_S // CONTROL_PERIOD_NS):
        if aircraft.advance(command) != again.advance(command):
            raise UsageError(
                f'aircraft {model.name}: JSBSim gives other numbers every time with the model '
                f'{model.model}; runs could not be repeated'
            )
    turned_rad = aircraft.state.yaw_rad
    if turned_rad < _LEAST_TURN_RAD:
        raise UsageError(
            f'aircraft {model.name}: with the wheel {math.degrees(command.steering_rad):.0f} deg '
            f'left it turned {math.degrees(turned_rad):+.1f} deg in {_TURN_S} s; its wheel does '
            'not steer it'
        )
