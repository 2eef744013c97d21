"""Steering law: cascade control from cross-track error via heading error to the nose wheel.

The paper needs a controller that always satisfies its specification on the true state; the gains
published with its simulator code do not, with any of our aircraft models. This cascade does: the
desired heading towards the centreline is proportional to the cross-track error, up to a limit, and
the nose wheel follows the difference between desired and current heading.

Also the interchangeable controllers: input an estimated tracking error, output a taxi command. One
is selected by a word: ``steering``, the shipped law with its gains, ``hold_short``, which also
stops before hold lines (:mod:`.hold_short`), a name added by an installed package
(:mod:`taxinet_ros.registry`), or a function in a Python file (``FILE.py:NAME``).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.arguments import a, check_fields, takes
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.core.units import typed_number
from taxinet_ros.core.user_code import (
    NO_NODE_HERE,
    RunCode,
    UserCode,
    command_of,
    find_plugin_code,
    find_user_code,
    is_node_elsewhere,
    names_user_code,
    pair_of_numbers,
)
from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.registry import CONTROLLERS, find, known, names

STOP = TaxiCommand(steering_rad=0.0, speed_mps=0.0)
"""Fail-safe command: nose wheel straight, full brakes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GainRange:
    """Valid range of one gain, both ends included, with its unit and meaning."""

    low: float
    high: float
    unit: str
    description: str

GAIN_RANGES: dict[str, GainRange] = {
    'cte_gain_rad_per_m': GainRange(
        low=0.0,
        high=1.0,
        unit='rad/m',
        description='heading towards the centreline per metre of cross-track error',
    ),
    'max_intercept_rad': GainRange(
        low=0.0,
        high=math.pi / 2,
        unit='rad',
        description='steepest heading at which the centreline is approached',
    ),
    'heading_gain': GainRange(
        low=0.0,
        high=10.0,
        unit='rad/rad',
        description='nose-wheel angle per angle between desired and current heading',
    ),
    'max_steering_rad': GainRange(
        low=0.0,
        high=math.pi / 3,
        unit='rad',
        description='maximum nose-wheel angle, to either side',
    ),
    'speed_mps': GainRange(
        low=0.0,
        high=10.0,
        unit='m/s',
        description='taxi speed to hold; at 5 that of the scenario',
    ),
}
"""Range of every field of :class:`SteeringGains`; the ROS parameters are derived from it."""


def typed_gain(name: str, text: str) -> float:
    """Read the text of a gain: a number, with a unit or in that of the gain.

    Raises:
        UsageError: unknown gain, no number, or a unit of something else.
    """
    if name not in GAIN_RANGES:
        raise UsageError(
            f'steering.{name}: unknown gain{near_miss(name, GAIN_RANGES)}; known: '
            f'{", ".join(GAIN_RANGES)}'
        )
    wanted = 'a number'
    try:
        number = typed_number(text, GAIN_RANGES[name].unit)
    except ValueError as error:
        wanted, number = str(error), math.nan
    else:
        with contextlib.suppress(ValueError):
            number = float(text) if number is None else number
    if number is None or not math.isfinite(number):
        raise UsageError(f'steering.{name}={text}: expected {wanted}')
    return number


@dataclass(frozen=True, kw_only=True, slots=True)
class SteeringGains:
    """Tuning of :func:`steer`; meaning, unit and range of each field are in :data:`GAIN_RANGES`.

    Raises:
        UsageError: a value is not finite or outside its range.
    """

    cte_gain_rad_per_m: float = math.radians(4.0)
    max_intercept_rad: float = math.radians(35.0)
    heading_gain: float = 1.6
    max_steering_rad: float = math.radians(15.0)
    speed_mps: float = 5.0

    def __post_init__(self) -> None:
        check_fields(self)
        for field in fields(self):
            value, valid = getattr(self, field.name), GAIN_RANGES[field.name]
            # A NaN fails the comparison too.
            if not valid.low <= value <= valid.high:
                raise UsageError(
                    f'steering: {field.name} is {value:g}, '
                    f'outside {valid.low:g}..{valid.high:g} {valid.unit}'
                )


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def steer(error: TrackingError, gains: SteeringGains) -> TaxiCommand:
    """Compute the taxi command for one estimate.

    The desired heading error is ``-clip(cte_gain * CTE, max_intercept)``: from the left of the
    centreline the nose points right. The nose-wheel angle is ``-heading_gain`` times the deviation
    of the heading error from it, clipped. The law is stateless.

    Args:
        error: cross-track and heading error, left positive.
        gains: tuning of the law.

    Returns:
        Nose-wheel angle [rad], left positive, and speed. An estimate that is not usable (declared
        invalid, NaN or infinite) gives :data:`STOP`.
    """
    if not error.usable:
        return STOP
    wanted_rad = -_clip(gains.cte_gain_rad_per_m * error.cte_m, gains.max_intercept_rad)
    steering_rad = -gains.heading_gain * (error.he_rad - wanted_rad)
    return TaxiCommand(
        steering_rad=_clip(steering_rad, gains.max_steering_rad), speed_mps=gains.speed_mps
    )


STEERING: Final = 'steering'
"""Word of the shipped law."""


class Controller(Protocol):
    """Controller interface: one command per estimate and control step.

    Attributes:
        word: a shipped name, the name given by a package, or ``python`` for a file.
        fingerprint: SHA-256 of the Python file and the files it lists, or of the package; empty for
            what is shipped.
        needs_image: whether :meth:`see` is called with each frame, ahead of its estimate.
        needs_sensors: whether :meth:`sense` is called ahead of each command.
    """

    word: str
    fingerprint: str
    needs_image: bool = False
    needs_sensors: bool = False

    def begin(self, scenario: Scenario | None = None) -> None:
        """Reset; called before each run.

        Args:
            scenario: scenario of the run, if any.
        """
        return

    def see(self, image: NDArray[np.uint8]) -> None:
        """Take the frame of the next estimate, (H, W, 3) uint8 RGB."""
        return

    def sense(self, measured: Measured) -> None:
        """Take what the sensors beside the camera deliver for the next command."""
        return

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """Return the command for one control period.

        Raises:
            UserCodeError: a user function failed; other controllers do not raise.
        """
        ...


class SteeringLaw(Controller):
    """The shipped law of :mod:`taxinet_ros.core.motion.controller`; stateless."""

    word = STEERING
    fingerprint = ''

    @takes(gains=a('a tx.SteeringGains', SteeringGains))
    def __init__(self, gains: SteeringGains) -> None:
        """``gains``: tuning of the law."""
        self.gains = self._gains = gains

    def begin(self, scenario: Scenario | None = None) -> None:
        """Use the scenario's speed if the gain ``speed_mps`` has its default."""
        self._gains = self.gains
        if scenario is not None and self.gains.speed_mps == SteeringGains().speed_mps:
            self._gains = replace(self.gains, speed_mps=scenario.speed_mps)

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """Return the command of :func:`steer`."""
        return steer(estimate, self._gains)


class UserController(Controller):
    """A user function from a :class:`TrackingError` to a command.

    It is called with every estimate, including unusable ones, and returns a pair
    ``(steering_rad, speed_mps)`` or a :class:`TaxiCommand`. One with a parameter ``sensors`` also
    receives the :class:`.Measured` of the step.
    """

    def __init__(self, code: UserCode) -> None:
        """Load the function.

        Raises:
            UsageError: the file's code fails.
        """
        self.word = code.word
        self.fingerprint = code.sha256
        self._run = RunCode(code)
        self.needs_sensors = self._run.needs_sensors

    def sense(self, measured: Measured) -> None:
        """See :class:`Controller`."""
        self._run.sense(measured)

    def begin(self, scenario: Scenario | None = None) -> None:
        """Reset to the initial state."""
        self._run.begin()

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """Return the function's command."""
        return self._run.answer(
            estimate, read_command, 'a pair (steering_rad, speed_mps), finite, speed not negative'
        )


def read_command(answer: Any) -> TaxiCommand | None:
    """Convert the return value of a user function to a command; None if invalid."""
    if isinstance(answer, TaxiCommand):
        answer = answer.steering_rad, answer.speed_mps
    pair = pair_of_numbers(answer)
    if pair is None or not (math.isfinite(pair[0]) and 0 <= pair[1] < math.inf):
        return None
    return TaxiCommand(steering_rad=pair[0], speed_mps=pair[1])


def make_controller(word: str, gains: SteeringGains) -> Controller:
    """Create the controller selected by a word.

    Args:
        word: a shipped name, one added by a package, or ``FILE.py:NAME``.
        gains: gains of the shipped law.

    Raises:
        UsageError: unknown word, or an unusable controller.
    """
    code = _code(word)
    if code is not None:
        return UserController(code)
    if word == STEERING:
        return SteeringLaw(gains)
    extension = find(CONTROLLERS, word)
    assert extension is not None
    made: Controller = extension.load()()
    return made


def check_controller(word: str, gains: Mapping[str, float] = {}, *, graph: bool = False) -> str:
    """Check that :func:`make_controller` will work, without running user code.

    Args:
        word: as for :func:`make_controller`.
        gains: gains set by the user, by name.
        graph: whether for a ROS graph, where an external node is allowed too.

    Returns:
        The controller's fingerprint; '' if only its node knows it.

    Raises:
        UsageError: as :func:`make_controller`; or gains are set for a controller without gains.
    """
    if word == STEERING:
        SteeringGains(**gains)
    elif gains:
        raise UsageError(
            f'steering.{min(gains)}: gains apply only to the shipped law, not to controller {word}'
        )
    if graph and is_node_elsewhere(word):
        command_of(word)
        return ''
    code = _code(word)
    return SteeringLaw.fingerprint if code is None else code.sha256


def _code(word: str) -> UserCode | None:
    """User code selected by a word; None for what is shipped.

    Raises:
        UsageError: unknown word, or an unusable controller.
    """
    extension = find(CONTROLLERS, word)
    if extension is not None:
        return None if extension.shipped else find_plugin_code(extension)
    if names_user_code(word):
        return find_user_code(word, 'controller')
    if is_node_elsewhere(word):
        raise UsageError(f'controller {word}: {NO_NODE_HERE}')
    raise UsageError(
        f'controller: {word!r} is unknown{near_miss(word, names(CONTROLLERS))}; known: '
        f'{known(CONTROLLERS, "or FILE.py:NAME")}'
    )


def controller_options(word: str) -> list[str]:
    """Command-line options that select a controller."""
    return [] if word == STEERING else ['--controller', word]


def gains_text(gains: Mapping[str, float]) -> str:
    """Steering gains as a controller reports them; the inverse of :func:`parse_gains`."""
    return ' '.join(f'{name}={value!r}' for name, value in gains.items())


def is_steering_law(words: str) -> bool:
    """Whether a controller's description is that of the steering law: its changed gains."""
    known = SteeringGains.__dataclass_fields__
    pairs = (word.partition('=') for word in words.split())
    return all(name in known and _is_number(value) for name, _, value in pairs)


def _is_number(text: str) -> bool:
    with contextlib.suppress(ValueError):
        float(text)
        return True
    return False


def parse_gains(words: str) -> dict[str, float]:
    """Parse steering gains from a controller's report.

    Raises:
        ValueError: not a report of gains.
        UsageError: a gain is out of range.
    """
    pairs = (word.split('=') for word in words.split())
    gains = {name: float(value) for name, value in pairs}
    if unknown := set(gains) - set(SteeringGains.__dataclass_fields__):
        raise ValueError(f'unknown steering gain {min(unknown)!r}')
    SteeringGains(**gains)
    return gains
