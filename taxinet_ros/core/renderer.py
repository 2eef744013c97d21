"""Who takes the pictures of a run: our own camera, another simulator, or a user's code.

A *renderer* is what ``--camera`` selects by name: ``ours``, one of the group
``taxinet_ros.cameras`` (:mod:`taxinet_ros.registry`), or ``FILE.py:NAME``. Not to be confused with
the scenario's key ``camera``, a document that says where the camera is mounted and what its lens
is: every renderer takes its pictures through that one. Aircraft, clock and lockstep stay ours: a
renderer gets a state and a time, and gives a frame. Faults of lens and sensor are added here.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.arguments import can_be_called
from taxinet_ros.core.camera.camera import pose
from taxinet_ros.core.camera.lens_faults import LensFaults
from taxinet_ros.core.camera.light import scenario_light
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    AIRCRAFT_MODEL,
    CAMERA,
    CAMERA_OFFSETS,
    CROSSING,
    DATAREFS,
    DATE,
    FAULTS,
    PLACE,
    RAIN,
    SHADOWS,
    SKY,
    TIME_OF_DAY,
    TRAFFIC,
)
from taxinet_ros.core.traffic.traffic import NOTHING_HELD, Holds
from taxinet_ros.core.types import AircraftState
from taxinet_ros.core.user_code import contained, find_user_code, names_user_code
from taxinet_ros.errors import InfraError, InfraKind, UsageError, near_miss
from taxinet_ros.registry import CAMERAS, find, known, names

_T = TypeVar('_T')
_USUAL = Scenario()

OURS = 'ours'
"""The shipped renderer, :class:`~taxinet_ros.core.camera.camera.Camera`."""

_LOOK = (
    SKY, RAIN, TIME_OF_DAY, DATE, SHADOWS, CROSSING, TRAFFIC, CAMERA, PLACE, AIRCRAFT_MODEL,
    DATAREFS,
)
PICTURE_KEYS = tuple(field.key for field in _LOOK)
"""Scenario keys that the look of the scene depends on; ``aircraft`` is what is seen of our own."""


class Renderer(Protocol):
    """The camera of one run, made from its scenario by a :class:`RendererMaker`."""

    def render(self, state: AircraftState, stamp_ns: int, /) -> NDArray[np.uint8]:
        """Take a picture, RGB uint8 of the shape of the scenario's camera model.

        Args:
            state: the aircraft's true state, in the runway frame.
            stamp_ns: simulated time since the start of the run [ns].

        Raises:
            InfraError: there is no picture of this state.
        """
        ...

    def close(self) -> None:
        """Give back what the run needed; called once, when the run has ended."""
        ...


class RendererMaker(Protocol):
    """Factory of renderers.

    Attributes:
        reproducible: whether equal scenarios, states and stamps give equal bytes; True if missing.
            Where it is False, a frame that was not recorded is gone.
        shows: the :data:`PICTURE_KEYS` that its pictures show; none if missing. What differs from
            its default and is not shown is refused by name.
    """

    reproducible: bool
    shows: Collection[str]

    def __call__(self, scenario: Scenario, /) -> Renderer:
        """Create the camera of a run.

        Raises:
            UsageError: it cannot show a scene as this.
            InfraError: it cannot be reached.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class ChosenRenderer:
    """A renderer other than ours, selected by name.

    Attributes:
        name: its name, or ``FILE.py:NAME``.
        fingerprint: SHA-256 of the package or file that provides it; empty for a shipped one.
        origin: ``PACKAGE VERSION`` that provides it; empty for a shipped one or a file.
        words: what error messages call it.
        reproducible, shows: see :class:`RendererMaker`.
    """

    name: str
    fingerprint: str
    origin: str
    words: str
    reproducible: bool
    shows: frozenset[str]
    _make: RendererMaker
    _failure: Callable[[BaseException], object]

    def make(self, scenario: Scenario) -> RunCamera:
        """Create the camera of a run, with the scenario's faults.

        Raises:
            UsageError: the scenario has a value that it does not show.
            InfraError: it failed.
        """
        self.check(scenario)
        return RunCamera(self, scenario)

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario with values that would have no effect on the pictures.

        Raises:
            UsageError: there is such a value.
        """
        scenario.sensor_set.refuse_camera(self.words)
        hidden = [
            field.key for field in (*_LOOK, *CAMERA_OFFSETS)
            if (field.carrier or field.key) not in self.shows
            and getattr(scenario, field.attribute) != getattr(_USUAL, field.attribute)
        ]
        if hidden:
            shown = ', '.join(sorted(self.shows)) or 'none of them'
            raise UsageError(
                f'{self.words}: does not show {", ".join(hidden)}, which would have no effect; '
                f'leave it at its default (it shows {shown})'
            )
        if reacting := scenario.others.reacting:
            raise UsageError(
                f'{self.words}: {reacting}, which only our camera shows; leave stands_within_m and '
                'starts_within_m out'
            )


class ForeignCode:
    """Code of others in one run: its failures are infrastructure errors that name it."""

    def __init__(
        self, scenario: Scenario, failure: Callable[[BaseException], object]
    ) -> None:
        """Begin ahead of the first step.

        Args:
            scenario: of the run, with its faults.
            failure: error that reports an exception of the code.
        """
        self._scenario, self._failure = scenario, failure
        self._step = -1

    def _close(self, made: object) -> None:
        """Let it give back what it took; the run is over, and keeps its result whatever comes."""
        close = getattr(made, 'close', None)
        if close is not None:
            with contextlib.suppress(InfraError, UsageError):
                self._call(close)

    def _picture(self, image: Any, state: AircraftState, stamp_ns: int) -> NDArray[np.uint8]:
        """A checked copy of its picture, with the scenario's faults of lens and sensor."""
        shape = self._scenario.camera_model.shape
        if not isinstance(image, np.ndarray):
            raise self._broken(f'the picture is {type(image).__name__}, no array')
        if image.shape != shape or image.dtype != np.uint8:
            # A network would produce an estimate from any array.
            raise self._broken(f'the picture is {image.shape} {image.dtype}, not {shape} uint8')
        picture: NDArray[np.uint8] = np.array(image, order='C')  # it may reuse its buffer
        if self._lens.any:
            _, to_optical, _ = pose(state, self._scenario.camera_model)
            picture = self._lens.apply(picture, to_optical, stamp_ns)
        return picture

    @cached_property
    def _lens(self) -> LensFaults:
        model = self._scenario.camera_model
        light = scenario_light(self._scenario)
        return LensFaults(self._scenario, light, model.intrinsics, model.shape[:2])

    def _call(self, work: Callable[[], _T]) -> _T:
        try:
            with contained(
                lambda error: self._broken(str(self._failure(error))),
                passing=(InfraError, UsageError),
            ):
                return work()
        except InfraError as error:
            if error.step >= 0 or self._step < 0:
                raise
            raise InfraError(error.kind, error.who, self._step, error.detail) from error

    def _broken(self, detail: str) -> InfraError:
        return InfraError(InfraKind.SIM, 'simulator', self._step, detail)


class RunCamera(ForeignCode):
    """A renderer in one run."""

    def __init__(self, renderer: ChosenRenderer, scenario: Scenario) -> None:
        super().__init__(scenario, renderer._failure)
        # Faults are added here, to the pictures of any renderer.
        well = scenario.without_faults(*FAULTS)
        self._camera: Any = self._call(lambda: renderer._make(well))

    def render(
        self, state: AircraftState, stamp_ns: int, *, held: Holds = NOTHING_HELD
    ) -> NDArray[np.uint8]:
        """As :meth:`Renderer.render`, checked, with the faults of lens and sensor.

        ``held`` is empty, as others that react to the aircraft are refused.

        Raises:
            InfraError: there is no picture.
        """
        self._step = stamp_ns // self._scenario.period_ns
        image = self._call(lambda: self._camera.render(state, stamp_ns))
        return self._picture(image, state, stamp_ns)

    def close(self) -> None:
        """Let it give back what it took."""
        self._close(self._camera)


def find_renderer(name: str) -> ChosenRenderer | None:
    """Find who takes the pictures; None for our own camera.

    Args:
        name: ``ours``, a name of the group ``taxinet_ros.cameras``, or ``FILE.py:NAME``.

    Raises:
        UsageError: unknown name, or what it stands for cannot make cameras.
    """
    if name == OURS:
        return None
    failure: Callable[[BaseException], object]
    if names_user_code(name):
        code = find_user_code(name, 'camera')
        made: Any = code.make()
        words, fingerprint, origin, failure = f'camera {name}', code.sha256, '', code.failure
    else:
        extension = find(CAMERAS, name)
        if extension is None:
            raise UsageError(
                f'camera: {name!r} is unknown{near_miss(name, names(CAMERAS))}; known: '
                f"{known(CAMERAS, 'FILE.py:NAME')}; the scenario's key camera mounts one of ours"
            )
        made, words, failure = extension.load(), extension.words, extension.failure
        fingerprint, origin = '', ''
        if extension.shipped:
            words = f'camera {name}'
        else:
            fingerprint = extension.fingerprint
            origin = f'{extension.distribution} {extension.version}'
    if not callable(made) or not can_be_called(made, 'scenario'):
        raise UsageError(
            f'{words}: is {type(made).__name__}; expected a class or function that makes a camera '
            'from a scenario'
        )
    reproducible, shows = getattr(made, 'reproducible', True), getattr(made, 'shows', ())
    if not isinstance(reproducible, bool):
        raise UsageError(f'{words}: reproducible is {reproducible!r}, not True or False')
    if isinstance(shows, str) or not isinstance(shows, Collection):
        raise UsageError(f'{words}: shows is {shows!r}, not a list of scenario keys')
    if unknown := sorted(str(key) for key in shows if key not in PICTURE_KEYS):
        raise UsageError(
            f'{words}: shows {", ".join(unknown)}; known: {", ".join(PICTURE_KEYS)}'
        )
    return ChosenRenderer(
        name=name, fingerprint=fingerprint, origin=origin, words=words, reproducible=reproducible,
        shows=frozenset(shows), _make=made, _failure=failure,
    )
