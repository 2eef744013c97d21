"""The exchangeable controllers: an estimate of the tracking error in, a taxi command out.

One word chooses: ``steering``, the handwritten law with its gains, or a function in a Python file
(``FILE.py:NAME``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.node_words import NO_NODE_HERE, command_of, is_node_elsewhere
from taxinet_ros.core.steering import SteeringGains, steer
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.core.user_code import (
    RunCode,
    UserCode,
    find_user_code,
    names_user_code,
    pair_of_numbers,
)

STEERING: Final = 'steering'
"""The word of the handwritten law."""


class Controller(Protocol):
    """Answers one estimate per control step.

    Attributes:
        fingerprint: SHA-256 of the Python file with those that it lists; empty for the law.
    """

    fingerprint: str

    def begin(self) -> None:
        """Forget what came before; called before each run."""
        return

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """The command for one control period.

        Raises:
            UserCodeError: somebody's function failed; no other raises.
        """
        ...


class SteeringLaw(Controller):
    """The handwritten law of :mod:`taxinet_ros.core.steering`, which has no memory."""

    fingerprint = ''

    def __init__(self, gains: SteeringGains) -> None:
        """``gains``: tuning of the law."""
        self.gains = gains

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """See :func:`.steering.steer`."""
        return steer(estimate, self.gains)


class UserController(Controller):
    """A function of somebody's: a :class:`TrackingError` in, a command out.

    It is called with every estimate, also with one that is not ``usable``, and answers a pair
    ``(steering_rad, speed_mps)`` or a :class:`TaxiCommand`.
    """

    def __init__(self, code: UserCode) -> None:
        """Load it.

        Raises:
            UsageError: the file's code fails.
        """
        self.fingerprint = code.sha256
        self._run = RunCode(code)

    def begin(self) -> None:
        """Have it as it is when made."""
        self._run.begin()

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """What it answers; the simulator refuses numbers that are not finite."""
        return self._run.answer(estimate, _read_command, 'a pair (steering_rad, speed_mps)')


def _read_command(answer: Any) -> TaxiCommand | None:
    if isinstance(answer, TaxiCommand):
        return answer
    pair = pair_of_numbers(answer)
    return TaxiCommand(steering_rad=pair[0], speed_mps=pair[1]) if pair is not None else None


def make_controller(word: str, gains: SteeringGains) -> Controller:
    """The controller of a word.

    Args:
        word: :data:`STEERING` or ``FILE.py:NAME``.
        gains: of the law.

    Raises:
        UsageError: unknown word, or a file that cannot be used.
    """
    if word == STEERING:
        return SteeringLaw(gains)
    if names_user_code(word):
        return UserController(find_user_code(word, 'controller'))
    raise _unknown(word)


def check_controller(word: str, gains: Mapping[str, float] = {}, *, graph: bool = False) -> str:
    """See that :func:`make_controller` will work, without running anybody's code.

    Args:
        word: as there.
        gains: those that a person has set, by name.
        graph: it is for a graph, so a node elsewhere does too.

    Returns:
        The fingerprint that the controller will have; '' where only its node will tell.

    Raises:
        UsageError: as there; or gains are set for what has none.
    """
    if word == STEERING:
        SteeringGains(**gains)
        return SteeringLaw.fingerprint
    if gains:
        raise UsageError(
            f'--set steering.{min(gains)}: a gain of the steering law, which --controller {word} '
            'takes the place of'
        )
    if names_user_code(word):
        return find_user_code(word, 'controller').sha256
    if graph and is_node_elsewhere(word):
        command_of(word)
        return ''
    raise _unknown(word)


def controller_options(word: str) -> list[str]:
    """What to type after ``taxinet run`` for the controller of a word."""
    return [] if word == STEERING else ['--controller', word]


def _unknown(word: str) -> UsageError:
    if is_node_elsewhere(word):
        return UsageError(f'controller {word}: {NO_NODE_HERE}')
    return UsageError(f'controller: {word!r} is unknown; known: {STEERING}, or FILE.py:NAME')
