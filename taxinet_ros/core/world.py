"""The world of one run, observed and advanced step by step.

The simulated world is the aircraft on its runway with its wing camera. A package may add another
(:mod:`taxinet_ros.registry`). Its pictures may be taken by another camera than its own
(:mod:`taxinet_ros.core.renderer`): the world ``kmwh+flightgear`` is ours, seen by FlightGear.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.arguments import can_be_called
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, Observation, last_step
from taxinet_ros.core.datarefs import NO_DATAREFS, refuse_datarefs
from taxinet_ros.core.faults import SteeringFaults, shown_step
from taxinet_ros.core.motion.aircraft import Aircraft, full_steering_rad
from taxinet_ros.core.renderer import OURS, ChosenRenderer, ForeignCode, RunCamera, find_renderer
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CONTROL_RATE, FAULTS
from taxinet_ros.core.sensing import Sensing, check_rates, sensing_of
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.traffic.motion import TrafficMotion
from taxinet_ros.core.traffic.traffic import Holds
from taxinet_ros.core.types import AircraftState, TaxiCommand, step_stamp_ns
from taxinet_ros.errors import InfraError, InfraKind, UsageError, near_miss
from taxinet_ros.registry import FORK, KMWH, WORLDS, Extension, find, known, names, origin_words

_T = TypeVar('_T')
_START_M = 1.0

TAKES_DATAREFS = 'takes_datarefs'
"""Attribute of a package's world, true where it takes X-Plane's variables."""

SHOWS_TRAFFIC = 'shows_traffic'
"""Attribute of a package's world, true where it shows others on the ground."""


class World(Protocol):
    """Interface of the world of one run. One is created per run, so that runs are bit-identical.

    Attributes:
        last_seq: number of the last control step, :func:`last_step` of the scenario.
    """

    last_seq: int

    def observe(self, *, picture: bool = True) -> Observation:
        """Observe the current step, repeatably; ``picture`` False skips rendering.

        Raises:
            InfraError: the world failed.
        """
        ...

    def advance(self, command: TaxiCommand) -> None:
        """Advance by one control period under ``command``.

        Raises:
            InfraError: the world failed.
        """
        ...


@runtime_checkable
class Closable(Protocol):
    """A world that has something to give back at the end of a run."""

    def close(self) -> None:
        """Give it back; called once."""


def check_picture(now: Observation, who: str) -> None:
    """Check that there is a picture for those who need it: they would fail in silence.

    Args:
        now: observation of a world that was asked for a picture.
        who: who needs it.

    Raises:
        InfraError: there is none.
    """
    if now.image is None:
        raise InfraError(
            InfraKind.SIM, 'simulator', now.seq, f'the world has no picture, which {who} needs'
        )


class WorldMaker(Protocol):
    """Factory of worlds, as returned by :func:`find_world`."""

    def __call__(self, scenario: Scenario, *, pictures: bool = True) -> World:
        """Create a world at its first control step; ``pictures`` False: none will be requested."""
        ...


class SimulatedWorld(World):
    """The aircraft on its runway, and its wing camera."""

    def __init__(
        self, scenario: Scenario, *, pictures: bool = True,
        aircraft: Callable[[Scenario], Aircraft] = Aircraft,
        camera: Callable[[Scenario], Camera] = Camera,
    ) -> None:
        """Place the aircraft on the runway.

        Args:
            scenario: initial condition, light and weather.
            pictures: False: without camera.
            aircraft: factory of the aircraft.
            camera: factory of the camera, called for the first image.
        """
        refuse_datarefs(scenario.datarefs, f'world {KMWH}')
        self.last_seq, self._period_ns = last_step(scenario), scenario.period_ns
        self._aircraft = aircraft(scenario)
        self._scenario, self._pictures, self._make_camera = scenario, pictures, camera
        self._steering = SteeringFaults(
            scenario, self._aircraft.max_steering_rad, self._period_ns
        )
        self._seq = 0
        self._track = scenario.line
        self._motion = TrafficMotion(scenario.others, self._period_ns)
        self._arrive()
        self._sensing = sensing_of(scenario, self._period_ns, self._aircraft.state)
        self._aircraft.traced = self._sensing is not None and self._sensing.fast

    @cached_property
    def _camera(self) -> Camera:
        # Created for the first image: its ground takes most of the set-up time and 63 MB.
        return self._make_camera(self._scenario)

    def change(
        self, scenario: Scenario, *, aircraft: Aircraft | None = None, wheel_rad: float = 0.0
    ) -> None:
        """Go on from this step in another scene.

        Args:
            scenario: the scene; its start values have no effect.
            aircraft: placed at this step; None: the aircraft rolls on, in the wind and with the
                friction of the scene.
            wheel_rad: angle of the nose wheel until now [rad].
        """
        if aircraft is None:
            self._aircraft.change(scenario)
        else:
            self._aircraft = aircraft
        self._scenario = scenario
        if self._sensing is not None:
            self._sensing.change(scenario)
        self.__dict__.pop('_camera', None)
        self._steering = SteeringFaults(
            scenario, self._aircraft.max_steering_rad, self._period_ns, wheel_rad
        )
        self._arrive()

    def _arrive(self) -> None:
        """See where the aircraft is at the current step: what it holds, what the camera shows."""
        at, stamp_ns = self._aircraft.state, step_stamp_ns(self._seq, self._period_ns)
        held = self._motion.step(stamp_ns, at.x_m, at.y_m)
        if held is None:
            raise InfraError(InfraKind.SIM, 'simulator', self._seq, f'the aircraft is at {at}')
        self._held: Holds = held
        if shown_step(self._scenario, self._seq, self._period_ns) == self._seq:
            self._shown = at, stamp_ns, held

    def observe(self, *, picture: bool = True) -> Observation:
        """Observe the current step; ``picture`` False skips rendering."""
        stamp_ns = step_stamp_ns(self._seq, self._period_ns)
        image = None
        if picture and self._pictures:
            state, seen_ns, held = self._shown
            image = self._camera.render(state, seen_ns, held=held)
        return Observation(
            seq=self._seq, stamp_ns=stamp_ns, state=self._aircraft.state, image=image,
            track=self._track,
            measured=None if self._sensing is None else self._sensing.measured, held=self._held,
        )

    def advance(self, command: TaxiCommand) -> None:
        """Integrate one control period under ``command``."""
        stamp_ns = step_stamp_ns(self._seq, self._period_ns)
        if self._scenario.signals:
            self._aircraft.follow(self._scenario, stamp_ns)
        before = self._aircraft.state
        self._aircraft.advance(self._steering.apply(command, stamp_ns))
        self._seq += 1
        self._arrive()
        if self._sensing is not None:
            now = self._aircraft
            self._sensing.advance(now.states if now.traced else [before, now.state], self._held)


@dataclass(frozen=True, kw_only=True, slots=True)
class ChosenWorld:
    """A world selected by name.

    Attributes:
        name: name of the world, ``WORLD`` or ``WORLD+CAMERA``.
        fingerprint: SHA-256 of the packages that add it; empty for the simulated one.
        make: factory, called once per run.
        renderer: who takes its pictures; None: the world itself.
        repeats: whether equal commands give equal runs.
    """

    name: str
    fingerprint: str
    make: WorldMaker
    renderer: ChosenRenderer | None = None
    repeats: bool = True

    @property
    def reproducible(self) -> bool:
        """Whether a picture that was not recorded can be had again from states and scenario."""
        return not self.again_words

    @property
    def again_words(self) -> str:
        """Why a picture cannot be had again; '' where it can."""
        if not self.repeats:
            return f'world {world_and_camera(self.name)[0]} does not run the same way twice'
        return '' if self.renderer is None or self.renderer.reproducible else (
            f'camera {self.renderer.name} does not take the same picture twice'
        )

    @property
    def origin(self) -> str:
        """``NAME of PACKAGE VERSION``, in bags; ``fork`` of a forked run, '' of ours."""
        if self.name == FORK:
            return FORK
        world = world_and_camera(self.name)[0]
        if self.renderer is None:
            return origin_words(WORLDS, world)
        package = origin_words(WORLDS, world).partition(' of ')[2]
        packages = ', '.join(filter(None, (package, self.renderer.origin)))
        return f'{self.name} of {packages}' if packages else self.name


def world_and_camera(word: str) -> tuple[str, str]:
    """Split the word of a world: ``kmwh+flightgear`` is kmwh with the camera flightgear."""
    world, _, camera = word.partition('+')
    return world, camera or OURS


def world_word(world: str, camera: str | None) -> str:
    """Word of a world with a camera; the inverse of :func:`world_and_camera`.

    Raises:
        UsageError: the world names another camera.
    """
    if camera is None:
        return world
    alone, named = world_and_camera(world)
    if named not in (OURS, camera):
        raise UsageError(f'camera {camera}: world {world} names another; leave one out')
    return alone if camera == OURS else f'{alone}+{camera}'


def find_world(name: str, fingerprint: str = '') -> ChosenWorld:
    """Find a world by name: ``kmwh`` or one added by a package, with ``+CAMERA`` or without.

    Args:
        name: name of the world.
        fingerprint: required hash of its packages; '' for any.

    Raises:
        UsageError: unknown name, a package that cannot be imported or has no such callable, or a
            hash that differs from the required one.
    """
    if name == FORK:
        raise UsageError(
            'world fork: a forked run is repeated by forking its run again: taxinet fork'
        )
    world_name, camera = world_and_camera(name)
    world, renderer = _find_alone(world_name), find_renderer(camera)
    if renderer is not None:
        marks = [one for one in (world.fingerprint, renderer.fingerprint) if one]
        world = ChosenWorld(
            name=f'{world_name}+{renderer.name}', renderer=renderer, repeats=world.repeats,
            fingerprint=marks[0] if len(marks) == 1 else
            hashlib.sha256(' '.join(marks).encode()).hexdigest() if marks else '',
            make=functools.partial(_SeenWorld, world.make, renderer),
        )
    now = world.fingerprint
    if fingerprint and now != fingerprint:
        raise UsageError(
            f'{world.origin or name}: world {name} is {now[:12]} now, it was {fingerprint[:12]}; '
            'put the package back as it was'
        )
    return world


def _find_alone(name: str) -> ChosenWorld:
    """The world of a name, with its own camera."""
    extension = find(WORLDS, name)
    if extension is None:
        raise UsageError(
            f'world: {name!r} is unknown{near_miss(name, names(WORLDS))}; known: {known(WORLDS)}'
        )
    made: Any = extension.load()
    if name == KMWH:
        return ChosenWorld(name=name, fingerprint='', make=made)
    if not callable(made):
        raise UsageError(
            f'{extension.words}: {extension.target} is {type(made).__name__}; expected a function '
            'that creates a world from a scenario'
        )
    if not can_be_called(made, 'scenario', pictures=True):
        raise UsageError(
            f'{extension.words}: {extension.target} cannot be called as {extension.target}('
            'scenario, pictures=True), which makes the world of a run'
        )
    return ChosenWorld(
        name=name, fingerprint='' if extension.shipped else extension.fingerprint,
        make=functools.partial(_PluginWorld, extension, made),
        repeats=getattr(made, 'reproducible', True) is not False,
    )


def world_options(name: str) -> list[str]:
    """Command-line options that select a world."""
    world, camera = world_and_camera(name)
    return [
        *([] if world == KMWH else ['--world', world]),
        *([] if camera == OURS else ['--camera', camera]),
    ]


@contextlib.contextmanager
def closing(world: World) -> Iterator[World]:
    """Context of a run in a world; :func:`close_world` at its end."""
    try:
        yield world
    finally:
        close_world(world)


def close_world(world: World) -> None:
    """End a world's run: another simulator is given back."""
    if isinstance(world, Closable):
        world.close()


class _SeenWorld(World):
    """A world whose pictures another camera takes, frozen frames included."""

    def __init__(
        self, make: WorldMaker, renderer: ChosenRenderer, scenario: Scenario, *,
        pictures: bool = True,
    ) -> None:
        renderer.check(scenario)
        # What it shows the world need not know.
        world_scenario = dataclasses.replace(scenario, datarefs=NO_DATAREFS)
        self._world = make(world_scenario, pictures=False)
        self.last_seq = self._world.last_seq
        self._renderer, self._scenario, self._pictures = renderer, scenario, pictures
        self._camera: RunCamera | None = None
        self._shown, self._seq = self._world.observe(picture=False), 0
        self._frame: NDArray[np.uint8] | None = None

    def observe(self, *, picture: bool = True) -> Observation:
        now = self._world.observe(picture=False)
        image = self._picture().copy() if picture and self._pictures else None
        return dataclasses.replace(now, image=image)

    def _picture(self) -> NDArray[np.uint8]:
        """The frame of the shown step, taken once: another would be a different one."""
        if self._frame is None:
            if self._camera is None:
                self._camera = self._renderer.make(self._scenario)
            self._frame = self._camera.render(self._shown.state, self._shown.stamp_ns)
        return self._frame

    def advance(self, command: TaxiCommand) -> None:
        self._world.advance(command)
        self._seq += 1
        if shown_step(self._scenario, self._seq, self._scenario.period_ns) == self._seq:
            self._shown, self._frame = self._world.observe(picture=False), None

    def close(self) -> None:
        if self._camera is not None:
            self._camera.close()
        close_world(self._world)


class _PluginWorld(ForeignCode, World):
    """World of a package.

    It gets the scenario without faults, which are added to its pictures and commands here.
    """

    def __init__(
        self, extension: Extension, make: WorldMaker, scenario: Scenario, *, pictures: bool = True
    ) -> None:
        super().__init__(scenario, extension.failure)
        if scenario.others.objects and not getattr(make, SHOWS_TRAFFIC, False):
            raise UsageError(
                f'{extension.words}: the world does not show traffic (no attribute '
                f'{SHOWS_TRAFFIC}); leave it out, or take the world {KMWH}'
            )
        if reacting := scenario.others.reacting:
            raise UsageError(
                f'{extension.words}: {reacting}, as none does but in the world {KMWH}; leave '
                'stands_within_m and starts_within_m out'
            )
        if not getattr(make, TAKES_DATAREFS, False):
            refuse_datarefs(scenario.datarefs, extension.words)
        if scenario.period_ns != CONTROL_PERIOD_NS:
            raise UsageError(
                f'{extension.words}: {CONTROL_RATE.key} would have no effect, as only the world '
                f'{KMWH} has another; leave it out'
            )
        check_rates(scenario, CONTROL_PERIOD_NS, extension.words)
        self.last_seq = last_step(scenario)
        self._pictures = pictures
        self._shown: NDArray[np.uint8] | None = None
        model = scenario.aircraft_model
        self._steering = SteeringFaults(
            scenario, model.max_steering_rad or full_steering_rad(model), CONTROL_PERIOD_NS
        )
        well = scenario.without_sensors().without_faults(*FAULTS)
        if well.signals:
            raise UsageError(
                f'{extension.words}: {", ".join(well.points)} would have no effect, as only the '
                f'world {KMWH} changes within a run; leave it out'
            )
        self._world = self._call(lambda: make(well, pictures=pictures))
        told = self._call(lambda: self._world.last_seq)
        if told != self.last_seq:
            raise self._broken(f'last_seq is {told!r}; the scenario ends at step {self.last_seq}')
        self._step = 0
        self._sensing: Sensing | None = None
        self._sensed: tuple[int, AircraftState | None] = -1, None

    def observe(self, *, picture: bool = True) -> Observation:
        shown = shown_step(self._scenario, self._step, CONTROL_PERIOD_NS)
        # A picture that a frozen camera will repeat is needed even if not requested now.
        repeats = shown_step(self._scenario, self._step + 1, CONTROL_PERIOD_NS) == self._step
        wanted = (picture or (repeats and self._pictures)) and shown == self._step
        now = self._call(lambda: self._world.observe(picture=wanted))
        if not isinstance(now, Observation):
            raise self._broken(f'observed {type(now).__name__}, expected an Observation')
        if now.seq != self._step:
            raise self._broken(f'observed step {now.seq!r}, expected {self._step}')
        stamp_ns = self._step * CONTROL_PERIOD_NS
        if now.stamp_ns != stamp_ns:
            raise self._broken(f'observed stamp {now.stamp_ns!r} ns, expected {stamp_ns}')
        if not isinstance(now.state, AircraftState):
            raise self._broken(f'the state is {type(now.state).__name__}, expected AircraftState')
        if shown == self._step:
            self._shown = None if now.image is None else self._picture(
                now.image, now.state, stamp_ns
            )
        seen = Observation(
            seq=self._step, stamp_ns=stamp_ns, state=now.state,
            image=self._shown.copy() if picture and self._shown is not None else None,
            track=self._scenario.line, measured=self._measure(now.state),
        )
        if self._step == 0 and not self._scenario.line.is_runway:
            self._check_start(seen)
        return seen

    def _measure(self, state: AircraftState) -> Measured | None:
        """What the sensors deliver, once the state of the step is known."""
        step, before = self._sensed
        if before is None:
            self._sensing = sensing_of(self._scenario, CONTROL_PERIOD_NS, state)
        elif step < self._step and self._sensing is not None:
            self._sensing.advance([before, state])
        self._sensed = self._step, state
        return None if self._sensing is None else self._sensing.measured

    def _check_start(self, now: Observation) -> None:
        """A world that knows of no tracks would set the aircraft on the runway."""
        start = self._scenario
        x_m, y_m, _ = start.line.pose(start.distance_m, start.cross_track_m)
        away_m = math.hypot(now.state.x_m - x_m, now.state.y_m - y_m)
        if not away_m < _START_M:
            raise self._broken(
                f'the run begins {away_m:.1f} m from its start on the track {start.track}; a world '
                'has to place the aircraft by scenario.line.pose'
            )

    def advance(self, command: TaxiCommand) -> None:
        obeyed = self._steering.apply(command, self._step * CONTROL_PERIOD_NS)
        self._call(lambda: self._world.advance(obeyed))
        self._step += 1

    def close(self) -> None:
        """Let it give back what it took."""
        self._close(self._world)
