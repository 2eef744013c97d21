"""Taxiing aircraft: JSBSim, advanced one control period at a time, with a speed hold.

The scenario sets wind, gusts, runway friction and slope.
"""

from __future__ import annotations

import math
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import jsbsim

from taxinet_ros.core.gusts import M_PER_FT, Gusts
from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.runway_frame import GeodeticPose, MapPose, runway_frame
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand
from taxinet_ros.errors import InfraError, InfraKind


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


@dataclass(frozen=True, kw_only=True, slots=True)
class SpeedGains:
    """Speed-hold gains of one aircraft model.

    Attributes:
        lever_per_mps: proportional gain: power lever, 0..1, per m/s of speed error.
        lever_per_m: integral gain: lever per second and per m/s of speed error.
        brake_per_lever: brake, 0..1, per unit of lever below its stop.
        rolling_lever: lever that holds the taxi speed straight ahead; initial integral.
    """

    lever_per_mps: float
    lever_per_m: float
    brake_per_lever: float
    rolling_lever: float


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


CONTROL_PERIOD_NS = 100_000_000
"""Time between two control steps [ns]: the paper's 10 Hz."""
PHYSICS_HZ = 120
TAXI_SPEED_MPS = 5.0
"""Default ground speed of a scenario [m/s]."""
FRICTION = {'dry': 1.0, 'wet': 0.7, 'icy': 0.0625}
"""Tyre friction, lateral and in braking, relative to dry pavement.

Wet: 14 CFR 25.109(d)(1), a grooved wet runway has 70 percent of the dry braking coefficient. Icy:
EASA AMC 25.1591 gives 0.05 for ice; the models have 0.8 on dry pavement.
"""
_OWN_MODELS = Path(__file__).parent / 'aircraft_models'
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


@dataclass(frozen=True, kw_only=True, slots=True)
class AircraftModel:
    """A flight-dynamics model and its trimmed attitude in straight taxiing at taxi speed.

    The attitude follows :class:`~taxinet_ros.core.types.AircraftState`; a run that starts with it
    has no vertical or pitch transient.

    Attributes:
        name: name of the model's folder and of the file in it.
        folder: folder of model folders, None for JSBSim's own models.
        max_steering_rad: largest nose-wheel angle [rad].
        settled_z_m: centre of gravity above the ground [m].
        settled_pitch_rad, settled_roll_rad: attitude [rad].
        speed_gains: gains of the speed hold.
    """

    name: str
    folder: Path | None
    max_steering_rad: float
    settled_z_m: float
    settled_pitch_rad: float
    settled_roll_rad: float
    speed_gains: SpeedGains

MODELS = {
    'caravan': AircraftModel(
        name='caravan',
        folder=_OWN_MODELS,
        max_steering_rad=math.radians(15.0),
        settled_z_m=1.55011,
        settled_pitch_rad=math.radians(0.1064),
        settled_roll_rad=0.0,
        speed_gains=SpeedGains(
            lever_per_mps=0.8, lever_per_m=0.1, brake_per_lever=0.5, rolling_lever=0.0833
        ),
    ),
    'c172p': AircraftModel(
        name='c172p',
        folder=None,
        max_steering_rad=math.radians(10.0),
        settled_z_m=1.32824,
        settled_pitch_rad=math.radians(-2.4815),
        settled_roll_rad=math.radians(-0.1078),
        speed_gains=SpeedGains(
            lever_per_mps=2.5, lever_per_m=0.02, brake_per_lever=1.0, rolling_lever=0.0
        ),
    ),
}
"""Models by the value of ``Scenario.aircraft``."""


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
    (scratch / name).mkdir()
    tree.write(scratch / name / f'{name}.xml')
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


class Wind:
    """Wind of a scenario: steady, or with :class:`.Gusts`.

    Attributes:
        steady: whether it has no gusts.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Compute the wind vector."""
        speed_mps, from_rad = scenario.wind_speed_mps, scenario.wind_direction_rad
        self._north_mps = -speed_mps * math.cos(from_rad)
        self._east_mps = -speed_mps * math.sin(from_rad)
        self.steady = not scenario.gust_mps
        self._gusts = Gusts(scenario.gust_mps, int(scenario.gust_seed))

    def begin(self, fdm: jsbsim.FGFDMExec) -> None:
        """Set the mean wind in JSBSim."""
        fdm['atmosphere/wind-north-fps'] = self._north_mps / M_PER_FT
        fdm['atmosphere/wind-east-fps'] = self._east_mps / M_PER_FT

    def gusts(self, fdm: jsbsim.FGFDMExec, steps: int) -> Iterator[None]:
        """Set the gust at the aircraft's position before each of ``steps`` physics steps."""
        north_mps = fdm['velocities/v-north-fps'] * M_PER_FT - self._north_mps
        east_mps = fdm['velocities/v-east-fps'] * M_PER_FT - self._east_mps
        way_mps = math.hypot(north_mps, east_mps)
        # The specification aligns its axes with the mean relative wind; without one (at rest in
        # still air) the axes are arbitrary.
        north, east = (north_mps / way_mps, east_mps / way_mps) if way_mps else (1.0, 0.0)
        for _ in range(steps):
            along, across = self._gusts.along_mps, self._gusts.across_mps
            fdm['atmosphere/gust-north-fps'] = (along * north - across * east) / M_PER_FT
            fdm['atmosphere/gust-east-fps'] = (along * east + across * north) / M_PER_FT
            yield
            self._gusts.advance(way_mps / PHYSICS_HZ)


class Aircraft:
    """Aircraft of one run; starts at the scenario's pose and speed.

    Attributes:
        max_steering_rad: largest nose-wheel angle [rad]; commands are clipped to it.
    """

    def __init__(
        self, scenario: Scenario, *, period_ns: int = CONTROL_PERIOD_NS,
        model: AircraftModel | None = None, runway: Runway | None = None,
    ) -> None:
        """Load a model and place it on the runway.

        Args:
            scenario: start pose and aircraft model.
            period_ns: control period [ns], a whole number of physics steps.
            model: replaces the scenario's model.
            runway: replaces the scenario's runway.

        Raises:
            ValueError: ``period_ns`` is not a positive whole number of physics steps.
            InfraError: JSBSim cannot load or start the model.
        """
        self._steps, rest = divmod(period_ns * PHYSICS_HZ, NS_PER_S)
        if self._steps < 1 or rest:
            raise ValueError(f'period {period_ns} ns is no whole number of {PHYSICS_HZ} Hz steps')
        self._period_s = period_ns / NS_PER_S
        self._step = -1
        self._frame = runway_frame(runway or scenario.runway)
        self._model = model or MODELS[scenario.aircraft]
        self.max_steering_rad = self._model.max_steering_rad
        self._hold = SpeedHold(self._model.speed_gains)
        self._wind = Wind(scenario) if scenario.wind_speed_mps or scenario.gust_mps else None
        self._fdm = self._load(self._model.name, scenario=scenario)
        along_rad = self._place(scenario)
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
            InfraError: JSBSim failed, or the state is no longer finite.
        """
        if not (math.isfinite(command.steering_rad) and 0 <= command.speed_mps < math.inf):
            raise ValueError(f'not a command that an aircraft can follow: {command}')
        self._set_controls(command)
        self._step += 1
        self._attempt(self._integrate, 'run')
        self._state = self._measure()
        return self._state

    def _integrate(self) -> bool:
        run = self._fdm.run
        if self._wind is None or self._wind.steady:
            return all(run() for _ in range(self._steps))
        return all(run() for _ in self._wind.gusts(self._fdm, self._steps))

    def _load(self, name: str, *, scenario: Scenario) -> jsbsim.FGFDMExec:
        with captured_log() as log, tempfile.TemporaryDirectory() as scratch:
            fdm = jsbsim.FGFDMExec(None)
            fdm.set_debug_level(0)
            folder = self._model.folder
            windy, sloping = self._wind is not None, bool(scenario.slope_fraction)
            if windy or sloping:
                models = folder or Path(fdm.get_aircraft_path())
                folder = _adapted(models, name, Path(scratch), windy=windy, sloping=sloping)
            if folder is not None:
                fdm.set_aircraft_path(str(folder))
            self._attempt(lambda: fdm.load_model(name), f'loading {name}', log)
        fdm.set_dt(1 / PHYSICS_HZ)
        return fdm

    def _place(self, scenario: Scenario) -> float:
        """Set the initial pose; return the runway's true heading there [rad]."""
        x_m, y_m, yaw_rad = scenario.line.pose(
            scenario.distance_m, scenario.cross_track_m, scenario.heading_rad
        )
        pose = self._frame.to_geodetic(
            MapPose(x_m=x_m, y_m=y_m, z_m=self._model.settled_z_m, yaw_rad=yaw_rad)
        )
        fdm = self._fdm
        # Order matters: terrain before height above it, attitude before speeds.
        fdm['ic/terrain-elevation-ft'] = self._frame.elevation_m / M_PER_FT
        fdm['ic/lat-geod-rad'] = pose.latitude_rad
        fdm['ic/long-gc-rad'] = pose.longitude_rad
        fdm['ic/h-agl-ft'] = self._model.settled_z_m / M_PER_FT
        fdm['ic/psi-true-rad'] = pose.heading_rad
        fdm['ic/theta-rad'] = -self._model.settled_pitch_rad
        fdm['ic/phi-rad'] = self._model.settled_roll_rad
        # Parallel to the ground, not along the tilted body axis: the aircraft would sink.
        fdm['ic/vn-fps'] = scenario.speed_mps * math.cos(pose.heading_rad) / M_PER_FT
        fdm['ic/ve-fps'] = scenario.speed_mps * math.sin(pose.heading_rad) / M_PER_FT
        fdm['ic/vd-fps'] = 0.0
        return pose.heading_rad + yaw_rad

    def _start_rolling(self, scenario: Scenario, along_rad: float) -> None:
        fdm, lever = self._fdm, self._model.speed_gains.rolling_lever
        self._attempt(fdm.run_ic, 'run_ic')
        # Only now: initialisation would reset wind and slope.
        if self._wind is not None:
            self._wind.begin(fdm)
        if (friction := FRICTION[scenario.surface]) != FRICTION['dry']:
            fdm['ground/static-friction-factor'] = friction
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
        self._fdm['fcs/steer-cmd-norm'] = -steering_rad / limit
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
        pose = self._frame.to_map(
            GeodeticPose(
                latitude_rad=read['position/lat-geod-rad'],
                longitude_rad=read['position/long-gc-rad'],
                altitude_m=read['position/geod-alt-ft'] * M_PER_FT,
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
            speed_mps=read['velocities/u-fps'] * M_PER_FT,
            yaw_rate_radps=-read['velocities/psidot-rad_sec'],
        )

    def _failure(self, detail: str) -> InfraError:
        return InfraError(InfraKind.SIM, 'simulator', self._step, detail)
