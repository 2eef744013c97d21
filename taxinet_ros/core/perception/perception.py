"""Interchangeable perceptions: a camera frame or the truth in, an estimated tracking error out.

One word chooses: ``truth``, a shipped network such as ``taxinet`` or ``original``, what an
installed package adds (:mod:`taxinet_ros.registry`), or a file: weights that ``taxinet train`` has
written, anybody's network in ONNX, or a function in a Python file (``FILE.py:NAME``). An unknown
word is an error: a network test that silently ran on the truth would prove nothing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.perception.network import ARCHITECTURES, TaxiNet, is_frame
from taxinet_ros.core.perception.onnx.network import ONNX_SUFFIX
from taxinet_ros.core.perception.onnx.trial import tried_network
from taxinet_ros.core.perception.weights import SUFFIX, load_model
from taxinet_ros.core.types import TrackingError
from taxinet_ros.core.user_code import (
    NO_NODE_HERE,
    PluginCode,
    RunCode,
    UserCode,
    command_of,
    find_plugin_code,
    find_user_code,
    is_node_elsewhere,
    names_user_code,
    pair_of_numbers,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import PERCEPTIONS, Extension, find, known, names

NO_ESTIMATE = TrackingError(cte_m=0.0, he_rad=0.0, valid=False)
"""Answer of a perception without an estimate."""


class Perception(Protocol):
    """Estimates the tracking error once per control step, from nothing but its arguments.

    Attributes:
        word: its name where it is shipped or comes with a package; for a file ``weights``,
            ``onnx`` or ``python``.
        fingerprint: SHA-256 of the weights file, of the ONNX file with its description after it,
            of the Python file with those that it lists, or of the package; empty for the truth.
        needs_image: whether it looks at camera frames.
    """

    word: str
    fingerprint: str
    needs_image: bool

    def begin(self) -> None:
        """Reset; called before each run."""
        return

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return an estimate; equal arguments give equal estimates, independent of earlier calls.

        Args:
            image: camera frame, (200, 360, 3) uint8 RGB.
            truth: the true tracking error.

        Returns:
            The estimate, :data:`NO_ESTIMATE` where none can be made.

        Raises:
            UserCodeError: somebody's function failed; no other raises.
        """
        ...


class GroundTruth(Perception):
    """Perfect perception: its estimate is the truth; replaces the network to localise faults."""

    word = 'truth'
    fingerprint = ''
    needs_image = False

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return the truth, if given."""
        return NO_ESTIMATE if truth is None else truth


class Network(Protocol):
    """Interface of networks that evaluate a frame."""

    def look(self, image: NDArray[np.uint8]) -> tuple[float, float]:
        """Cross-track [m] and heading error [rad] seen on a camera frame (200, 360, 3) uint8."""
        ...


class NetworkPerception(Perception):
    """A neural network that uses the camera frame only, never the truth."""

    needs_image = True

    def __init__(self, network: Network, *, word: str, fingerprint: str) -> None:
        """See :class:`Perception` for what ``word`` and ``fingerprint`` are."""
        self.word = word
        self.fingerprint = fingerprint
        self._network = network

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return the network's estimate; invalid without a frame or with a non-finite output."""
        if image is None or not is_frame(image):
            return NO_ESTIMATE
        cte_m, he_rad = self._network.look(image)
        seen = TrackingError(cte_m=cte_m, he_rad=he_rad)
        return seen if seen.usable else NO_ESTIMATE


class UserPerception(Perception):
    """A user function: ``(200, 360, 3)`` uint8 RGB in, cross-track and heading error out.

    It answers a pair ``(cte_m, he_rad)``, a :class:`TrackingError`, or None where it cannot tell.
    One that has ``needs_image = False`` is given the true :class:`TrackingError` instead.
    """

    def __init__(self, code: UserCode) -> None:
        """Load it.

        Raises:
            UsageError: the file's code fails.
        """
        self.code = code
        self.word = code.word
        self.fingerprint = code.sha256
        self._run = RunCode(code)
        with code.running(UsageError):
            self.needs_image = bool(getattr(self._run.function, 'needs_image', True))

    def begin(self) -> None:
        """Reset to the initial state."""
        self._run.begin()

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return its estimate; invalid without its input or with a non-finite number."""
        if self.needs_image:
            if image is None or not is_frame(image):
                return NO_ESTIMATE
            argument: object = image.copy()  # it may write on what is its own
        elif truth is None:
            return NO_ESTIMATE
        else:
            argument = truth
        return self._run.answer(argument, read_estimate, 'a pair (cte_m, he_rad), or None')


def read_estimate(answer: Any) -> TrackingError | None:
    """The estimate that a function of somebody's answered; None where it is none."""
    if answer is None:
        return NO_ESTIMATE
    if not isinstance(answer, TrackingError):
        pair = pair_of_numbers(answer)
        if pair is None:
            return None
        answer = TrackingError(cte_m=pair[0], he_rad=pair[1])
    return answer if answer.usable else NO_ESTIMATE


def perception_names() -> list[str]:
    """The words that choose a perception: the truth, shipped networks, what packages add."""
    return names(PERCEPTIONS)


def make_perception(word_or_file: str) -> Perception:
    """The perception of a name, or the network in a file.

    Args:
        word_or_file: a name of :func:`perception_names`; or a ``.safetensors`` file with its model
            card beside it, an ``.onnx`` file with its description
            (:mod:`taxinet_ros.core.perception.onnx.sidecar`), or a function in a Python file
            (:mod:`taxinet_ros.core.user_code`).

    Raises:
        UsageError: unknown word (the known ones are listed), or what cannot be used.
    """
    extension = find(PERCEPTIONS, word_or_file)
    if extension is not None:
        found = _loaded(extension)
        if isinstance(found, Path):
            return _network(found, extension.name)
        return UserPerception(found) if isinstance(found, PluginCode) else found
    if names_user_code(word_or_file):
        return UserPerception(find_user_code(word_or_file, 'perception'))
    path = _network_file(word_or_file)
    return _network(path, 'onnx' if path.suffix == ONNX_SUFFIX else 'weights')


def check_perception(word_or_file: str, *, graph: bool = False) -> str:
    """Check that :func:`make_perception` will work, without building a network.

    Args:
        word_or_file: as there.
        graph: it is for a graph, so a node elsewhere does too.

    Returns:
        The fingerprint that the perception will have; '' where only its node will tell.

    Raises:
        UsageError: as :func:`make_perception`.
    """
    extension = find(PERCEPTIONS, word_or_file)
    if extension is not None:
        found = _loaded(extension)
        if isinstance(found, Path):
            return _fingerprint(found)
        return found.sha256 if isinstance(found, PluginCode) else found.fingerprint
    if graph and is_node_elsewhere(word_or_file):
        command_of(word_or_file)
        return ''
    if names_user_code(word_or_file):
        return find_user_code(word_or_file, 'perception').sha256
    return _fingerprint(_network_file(word_or_file))


def _loaded(extension: Extension) -> Path | PluginCode | Perception:
    """What stands behind a name: the file of a network, somebody's code, or a class of ours."""
    found: Any = extension.load()
    if isinstance(found, Path):
        if found.suffix not in (SUFFIX, ONNX_SUFFIX):
            raise UsageError(f'{extension.words}: {found}: expected a {SUFFIX} or {ONNX_SUFFIX} '
                             'file')
        return found
    if not extension.shipped:
        return find_plugin_code(extension)
    perception: Perception = found()
    return perception


def _network(path: Path, word: str) -> Perception:
    """The network in a file: one of ours, or a third party's once it has been tried."""
    if path.suffix == ONNX_SUFFIX:
        theirs, fingerprint = tried_network(path)
        return NetworkPerception(theirs, word=word, fingerprint=fingerprint)
    model = load_model(path)
    ours = TaxiNet(ARCHITECTURES[model.card.architecture], model.weights)
    return NetworkPerception(ours, word=word, fingerprint=model.fingerprint)


def _fingerprint(path: Path) -> str:
    if path.suffix == ONNX_SUFFIX:
        return tried_network(path)[1]
    return load_model(path).fingerprint


def _network_file(text: str) -> Path:
    if is_node_elsewhere(text):
        raise UsageError(f'perception {text}: {NO_NODE_HERE}')
    path = Path(text)
    if path.suffix not in (SUFFIX, ONNX_SUFFIX):
        words = known(PERCEPTIONS, f'a {SUFFIX} or {ONNX_SUFFIX} file', 'or FILE.py:NAME')
        raise UsageError(f'perception: {text!r} is unknown; known: {words}')
    return path
