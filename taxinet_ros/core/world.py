"""The world of one run, observed and advanced step by step.

The simulated one is the aircraft on its runway, and what its wing camera sees. A package may bring
another (:mod:`taxinet_ros.registry`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS, Aircraft
from taxinet_ros.core.camera.camera import IMAGE_HEIGHT, IMAGE_WIDTH, Camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import AircraftState, TaxiCommand
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.registry import KMWH, WORLDS, Extension, find, known

_T = TypeVar('_T')


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Observation:
    """What there is to know at one control step, before it is answered.

    Attributes:
        seq: control step, from 0.
        stamp_ns: simulated time since the start of the run [ns].
        state: true state of the aircraft.
        image: camera frame, (200, 360, 3) uint8 RGB; None where no one asked for pictures.
    """

    seq: int
    stamp_ns: int
    state: AircraftState
    image: NDArray[np.uint8] | None


def last_step(scenario: Scenario, period_ns: int = CONTROL_PERIOD_NS) -> int:
    """Number of the last control step of a run: steps 0..N cover the duration, both ends included.

    Raises:
        UsageError: the duration is not a whole number of control periods.
    """
    steps, rest = divmod(scenario.duration_ns, period_ns)
    if rest:
        raise UsageError(
            f'scenario: duration {scenario.duration_s:g} s is not a multiple of the '
            f'control period {period_ns / 1e9:g} s'
        )
    return steps


class World(Protocol):
    """One run's world, stepped from outside. A fresh one per run keeps runs bit-identical.

    Attributes:
        last_seq: number of the last control step, :func:`last_step` of the scenario.
    """

    last_seq: int

    def observe(self, *, picture: bool = True) -> Observation:
        """The present moment, as often as it is asked for; ``picture`` False saves the picture.

        Raises:
            InfraError: the world is broken.
        """
        ...

    def advance(self, command: TaxiCommand) -> None:
        """Let one control period pass under ``command``.

        Raises:
            InfraError: the world is broken.
        """
        ...


class WorldMaker(Protocol):
    """Makes the world of a run; what :func:`find_world` gives is one."""

    def __call__(self, scenario: Scenario, *, pictures: bool = True) -> World:
        """A world at its first control step; ``pictures`` False: no one will look at any."""
        ...


class SimulatedWorld(World):
    """The aircraft on its runway, and its wing camera."""

    def __init__(
        self, scenario: Scenario, *, pictures: bool = True,
        aircraft: Callable[[Scenario], Aircraft] = Aircraft,
        camera: Callable[[Scenario], Camera] = Camera,
    ) -> None:
        """Set the aircraft on the runway.

        Args:
            scenario: where it starts, and in which light and weather.
            pictures: False leaves the camera out.
            aircraft: makes the aircraft.
            camera: makes the camera, for the first picture.
        """
        self.last_seq = last_step(scenario)
        self._aircraft = aircraft(scenario)
        self._scenario, self._pictures, self._make_camera = scenario, pictures, camera
        self._seq = 0

    @cached_property
    def _camera(self) -> Camera:
        # Made for the first picture: its ground takes longer than all else here, and 63 MB.
        return self._make_camera(self._scenario)

    def observe(self, *, picture: bool = True) -> Observation:
        """Photograph the present moment; ``picture`` False saves the picture."""
        stamp_ns = self._seq * CONTROL_PERIOD_NS
        state = self._aircraft.state
        image = self._camera.render(state, stamp_ns) if picture and self._pictures else None
        return Observation(seq=self._seq, stamp_ns=stamp_ns, state=state, image=image)

    def advance(self, command: TaxiCommand) -> None:
        """Integrate one control period under ``command``."""
        self._aircraft.advance(command)
        self._seq += 1


@dataclass(frozen=True, kw_only=True, slots=True)
class ChosenWorld:
    """A world that a name chooses.

    Attributes:
        name: of it.
        fingerprint: SHA-256 of the package that brings it; empty for the simulated one.
        make: makes one for each run.
    """

    name: str
    fingerprint: str
    make: WorldMaker


def find_world(name: str, fingerprint: str = '') -> ChosenWorld:
    """The world of a name, ``kmwh`` or one that a package adds.

    Args:
        name: of it.
        fingerprint: what the package that brings it has to be; '' where it may be any.

    Raises:
        UsageError: unknown name, a package that cannot be imported or has nothing to call there,
            or one that is not what is on record.
    """
    extension = find(WORLDS, name)
    if extension is None:
        raise UsageError(f'world: {name!r} is unknown; known: {known(WORLDS)}')
    made: Any = extension.load()
    if extension.shipped:
        return ChosenWorld(name=name, fingerprint='', make=made)
    if not callable(made):
        raise UsageError(
            f'{extension.words}: {extension.target} is {type(made).__name__}; expected what makes '
            'a world of a scenario'
        )
    now = extension.fingerprint
    if fingerprint and now != fingerprint:
        raise UsageError(
            f'{extension.words}: world {name} is {now[:12]} now, it was {fingerprint[:12]}; put '
            'the package back as it was'
        )
    return ChosenWorld(
        name=name, fingerprint=now, make=functools.partial(_PluginWorld, extension, made)
    )


def world_options(name: str) -> list[str]:
    """What to type after ``taxinet run`` for the world of a name."""
    return [] if name == KMWH else ['--world', name]


class _PluginWorld(World):
    """A package's world: where its code fails, the bench is broken, and whose it is is told."""

    def __init__(
        self, extension: Extension, make: WorldMaker, scenario: Scenario, *, pictures: bool = True
    ) -> None:
        self._extension, self._seq = extension, -1
        self.last_seq = last_step(scenario)
        self._world = self._call(lambda: make(scenario, pictures=pictures))
        told = self._call(lambda: self._world.last_seq)
        if told != self.last_seq:
            raise self._broken(f'last_seq is {told!r}; the scenario ends at step {self.last_seq}')
        self._seq = 0

    def observe(self, *, picture: bool = True) -> Observation:
        now = self._call(lambda: self._world.observe(picture=picture))
        if not isinstance(now, Observation):
            raise self._broken(f'observed {type(now).__name__}, expected an Observation')
        if now.seq != self._seq:
            raise self._broken(f'observed step {now.seq}, expected {self._seq}')
        image, frame = now.image, (IMAGE_HEIGHT, IMAGE_WIDTH, 3)
        if image is None:
            return now
        if not isinstance(image, np.ndarray):
            raise self._broken(f'the picture is {type(image).__name__}, no array')
        if image.shape != frame or image.dtype != np.uint8:
            # A network would make an estimate up from anything.
            got = f'{image.shape} {image.dtype}'
            raise self._broken(f'the picture is {got}, not {frame} uint8')
        return now

    def advance(self, command: TaxiCommand) -> None:
        self._call(lambda: self._world.advance(command))
        self._seq += 1

    def _call(self, work: Callable[[], _T]) -> _T:
        try:
            return work()
        except (InfraError, UsageError):
            raise
        except Exception as error:
            raise self._broken(str(self._extension.failure(error))) from error

    def _broken(self, detail: str) -> InfraError:
        return InfraError(InfraKind.SIM, 'simulator', self._seq, detail)
