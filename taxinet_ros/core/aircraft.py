"""The aircraft on its wheels: JSBSim, one control period at a time, with the pilot's speed hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import jsbsim

from taxinet_ros.core.place.runway import Runway
from taxinet_ros.core.place.runway_frame import GeodeticPose, MapPose, runway_frame
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand
from taxinet_ros.errors import InfraError, InfraKind


class CapturedLog(jsbsim.FGLogger):
    """Collects what JSBSim says.

    Attributes:
        text: everything so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.text = ''

    def set_level(self, level: jsbsim.LogLevel) -> None:
        """Ignore the severity of the next record."""

    def file_location(self, filename: str, line: int) -> None:
        """Ignore where in JSBSim's input the next record comes from."""

    def message(self, message: str) -> None:
        """Keep a piece of text."""
        self.text += message

    def format(self, style: jsbsim.LogFormat) -> None:
        """Ignore colours."""

    def flush(self) -> None:
        """End a record."""
        self.text += '\n'


@contextmanager
def captured_log() -> Iterator[CapturedLog]:
    """Catch what JSBSim logs on this thread while the context lasts."""
    outer = jsbsim.get_logger()
    log = CapturedLog()
    jsbsim.set_logger(log)
    try:
        yield log
    finally:
        jsbsim.set_logger(outer)


@dataclass(frozen=True, kw_only=True, slots=True)
class SpeedGains:
    """Tuning of one aircraft model.

    Attributes:
        lever_per_mps: power lever, 0..1, per m/s of missing speed.
        lever_per_m: growth of the lever per second and per m/s of missing speed.
        brake_per_lever: brake, 0..1, per unit of lever below its stop.
        rolling_lever: lever that holds the taxi speed straight ahead; where the integral starts.
    """

    lever_per_mps: float
    lever_per_m: float
    brake_per_lever: float
    rolling_lever: float


class SpeedHold:
    """Holds a ground speed; a wanted speed of 0 closes the lever and stands on the brakes."""

    def __init__(self, gains: SpeedGains) -> None:
        """Start in balance: the lever holds a steady roll."""
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
        # The integral may not wind up past what the lever can give.
        integral = self._integral + self._gains.lever_per_m * missing_mps * dt_s
        self._integral = min(max(integral, 0.0), 1.0)
        lever = self._integral + self._gains.lever_per_mps * missing_mps
        brake = -lever * self._gains.brake_per_lever
        return min(max(lever, 0.0), 1.0), min(max(brake, 0.0), 1.0)


CONTROL_PERIOD_NS = 100_000_000
"""Time between two control steps [ns]: the paper's 10 Hz."""
PHYSICS_HZ = 120
TAXI_SPEED_MPS = 5.0
"""Ground speed at the start of a run [m/s]."""
M_PER_FT = 0.3048
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
    """A flight-dynamics model, and how it stands while rolling straight at the taxi speed.

    The attitude is that of :class:`~taxinet_ros.core.types.AircraftState`; a run that starts with
    it neither drops nor nods.

    Attributes:
        name: of the model's folder, and of the file in it.
        folder: folder of model folders, None for the models that come with JSBSim.
        max_steering_rad: largest nose-wheel angle [rad].
        settled_z_m: centre of gravity above the ground [m].
        settled_pitch_rad, settled_roll_rad: attitude [rad].
        speed_gains: tuning of the speed hold.
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
"""Models by the word of ``Scenario.aircraft``."""


class Aircraft:
    """The aircraft of one run, rolling at :data:`TAXI_SPEED_MPS` from the scenario's start pose.

    Attributes:
        max_steering_rad: largest nose-wheel angle [rad]; commands are clipped to it.
    """

    def __init__(
        self, scenario: Scenario, *, period_ns: int = CONTROL_PERIOD_NS,
        model: AircraftModel | None = None, runway: Runway | None = None,
    ) -> None:
        """Load a model and set it on the runway.

        Args:
            scenario: start pose and kind of aircraft.
            period_ns: control period [ns], a whole number of physics steps.
            model: that takes the place of the scenario's.
            runway: that takes the place of the scenario's.

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
        self._fdm = self._load(self._model.name)
        self._place(scenario)
        self._start_rolling()
        self._step = 0
        self._state = self._measure()

    @property
    def state(self) -> AircraftState:
        """Present pose and motion in ``map``."""
        return self._state

    def advance(self, command: TaxiCommand) -> AircraftState:
        """Integrate one control period with the nose wheel, the lever and the brakes held.

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
        return all(run() for _ in range(self._steps))

    def _load(self, name: str) -> jsbsim.FGFDMExec:
        with captured_log() as log:
            fdm = jsbsim.FGFDMExec(None)
            fdm.set_debug_level(0)
            if self._model.folder is not None:
                fdm.set_aircraft_path(str(self._model.folder))
            self._attempt(lambda: fdm.load_model(name), f'loading {name}', log)
        fdm.set_dt(1 / PHYSICS_HZ)
        return fdm

    def _place(self, scenario: Scenario) -> None:
        pose = self._frame.to_geodetic(
            MapPose(
                x_m=scenario.distance_m,
                y_m=scenario.cross_track_m,
                z_m=self._model.settled_z_m,
                yaw_rad=scenario.heading_rad,
            )
        )
        fdm = self._fdm
        # The height above the terrain comes after the terrain, and speeds after the attitude.
        fdm['ic/terrain-elevation-ft'] = self._frame.elevation_m / M_PER_FT
        fdm['ic/lat-geod-rad'] = pose.latitude_rad
        fdm['ic/long-gc-rad'] = pose.longitude_rad
        fdm['ic/h-agl-ft'] = self._model.settled_z_m / M_PER_FT
        fdm['ic/psi-true-rad'] = pose.heading_rad
        fdm['ic/theta-rad'] = -self._model.settled_pitch_rad
        fdm['ic/phi-rad'] = self._model.settled_roll_rad
        # Along the ground, not along the tilted body axis, or the aircraft would start to sink.
        fdm['ic/vn-fps'] = TAXI_SPEED_MPS * math.cos(pose.heading_rad) / M_PER_FT
        fdm['ic/ve-fps'] = TAXI_SPEED_MPS * math.sin(pose.heading_rad) / M_PER_FT
        fdm['ic/vd-fps'] = 0.0

    def _start_rolling(self) -> None:
        fdm, lever = self._fdm, self._model.speed_gains.rolling_lever
        self._attempt(fdm.run_ic, 'run_ic')
        propulsion = fdm.get_propulsion()
        if not propulsion.get_num_engines():  # the caravan's thrust is an external force
            return
        # Starting an engine also opens its throttle and leaves it at full speed. One step with the
        # motion frozen carries our lever to the engine, which then settles to its speed there.
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
        """Do something that JSBSim refuses by an exception, or by False and a line in its log."""
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
        # JSBSim has y right and z down: its pitch is nose up, its turns are clockwise.
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
