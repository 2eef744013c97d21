"""Interchangeable perceptions: input a camera frame or the truth, output a tracking error.

A perception is selected by a name or a file: ``truth``, a shipped network such as ``taxinet`` or
``original``, a name added by an installed package (:mod:`taxinet_ros.registry`), weights written by
``taxinet train``, a network in ONNX, or a function in a Python file (``FILE.py:NAME``). An unknown
name is an error, with no fallback to the truth.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.arguments import has_parameter
from taxinet_ros.core.perception.domain import Domain, domain_doubts
from taxinet_ros.core.perception.eye import Eye, find_eye
from taxinet_ros.core.perception.network import ARCHITECTURES, TaxiNet, is_frame
from taxinet_ros.core.perception.onnx.network import ONNX_SUFFIX, NetworkFiles
from taxinet_ros.core.perception.onnx.sidecar import parse_sidecar, sidecar_path
from taxinet_ros.core.perception.onnx.trial import tried_network
from taxinet_ros.core.perception.weights import SUFFIX, card_path, load_card, load_model
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.types import NO_ESTIMATE, UNKNOWN_COVARIANCE, TrackingError
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
from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.registry import PERCEPTIONS, Extension, find, known, names

_AT_KMWH, _ANYWHERE = 'taxinet', 'anywhere'
"""The shipped networks for the usual runway, and for runways and cameras never seen."""


class Perception(Protocol):
    """Estimates the tracking error once per control step, from its arguments only.

    Attributes:
        word: name, if shipped or provided by a package; for a file ``weights``, ``onnx`` or
            ``python``.
        fingerprint: SHA-256 of the weights file, of the ONNX file followed by its description, of
            the Python file and those that it lists, or of the package; empty for the truth.
        needs_image: whether it uses camera frames.
        needs_sensors: whether :meth:`sense` is called ahead of each estimate.
    """

    word: str
    fingerprint: str
    needs_image: bool
    needs_sensors: bool = False

    def begin(self, rig: Rig | None = None) -> None:
        """Reset; called before each run.

        Args:
            rig: camera and aircraft of the run; None if unknown.
        """
        return

    def sense(self, measured: Measured) -> None:
        """Take what the other sensors deliver for the next estimate."""
        return

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return an estimate; equal arguments give equal estimates, independent of earlier calls.

        Args:
            image: camera frame, (200, 360, 3) uint8 RGB.
            truth: the true tracking error.

        Returns:
            The estimate, or :data:`NO_ESTIMATE`.

        Raises:
            UserCodeError: a user function failed; other perceptions do not raise.
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
        """Estimate cross-track [m] and heading error [rad] from a frame (200, 360, 3) uint8.

        One with a view: from the picture of its eye, (64, 192) uint8.
        """
        ...


class NetworkPerception(Perception):
    """A neural network that uses the camera frame only, never the truth."""

    needs_image = True

    def __init__(
        self, network: Network, *, word: str, fingerprint: str, view: str | None = None
    ) -> None:
        """See :class:`Perception` for ``word`` and ``fingerprint``.

        Args:
            network: the network.
            word: its name.
            fingerprint: its digest.
            view: virtual camera that it sees through, a name of :data:`.eye.VIEWS`; None if it sees
                the frames as they are.
        """
        self.word = word
        self.fingerprint = fingerprint
        self.view = view
        self._network = network
        self._eye: Eye | None = None

    def begin(self, rig: Rig | None = None) -> None:
        """Prepare the eye of the rig, if the network asks for one."""
        self._eye = None if self.view is None or rig is None else find_eye(self.view, rig)

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return the network's estimate; invalid without a frame or with a non-finite output.

        Raises:
            UsageError: it sees through a virtual camera, but the rig is unknown.
        """
        if image is None or not is_frame(image):
            return NO_ESTIMATE
        if self._eye is not None:
            image = self._eye.see(image)
        elif self.view is not None:
            raise UsageError(
                f'perception {self.word}: sees through the virtual camera {self.view}, for which '
                'camera and aircraft have to be known; of these frames they are not'
            )
        cte_m, he_rad = self._network.look(image)
        seen = TrackingError(cte_m=cte_m, he_rad=he_rad)
        return seen if seen.usable else NO_ESTIMATE


class UserPerception(Perception):
    """A user function: ``(200, 360, 3)`` uint8 RGB in, cross-track and heading error out.

    It returns a pair ``(cte_m, he_rad)``, with a third value their 2 x 2 covariance, a
    :class:`TrackingError`, or None for no estimate. With
    ``needs_image = False`` it receives the true :class:`TrackingError` instead of the image. One
    with a parameter ``rig`` also receives the :class:`.Rig` of the run, one with a parameter
    ``sensors`` the :class:`.Measured` of the step.
    """

    def __init__(self, code: UserCode) -> None:
        """Load the function.

        Raises:
            UsageError: the file's code fails.
        """
        self.code = code
        self.word = code.word
        self.fingerprint = code.sha256
        self._run = RunCode(code)
        self.needs_sensors = self._run.needs_sensors
        self._named: dict[str, Rig | None] = {}
        with code.running(UsageError):
            self.needs_image = bool(getattr(self._run.function, 'needs_image', True))

    def begin(self, rig: Rig | None = None) -> None:
        """Reset to the initial state."""
        self._run.begin()
        self._named = {'rig': rig} if has_parameter(self._run.function, 'rig') else {}

    def sense(self, measured: Measured) -> None:
        """See :class:`Perception`."""
        self._run.sense(measured)

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return the function's estimate; invalid without input or with a non-finite number."""
        if self.needs_image:
            if image is None or not is_frame(image):
                return NO_ESTIMATE
            argument: object = image.copy()  # the function may modify its argument
        elif truth is None:
            return NO_ESTIMATE
        else:
            argument = truth
        return self._run.answer(
            argument, read_estimate,
            'a pair (cte_m, he_rad), also with their covariance, or None', **self._named
        )


def read_estimate(answer: Any) -> TrackingError | None:
    """Convert the return value of a user function to an estimate; None if invalid.

    Raises:
        UsageError: its covariance is none.
    """
    if answer is None:
        return NO_ESTIMATE
    if not isinstance(answer, TrackingError):
        covariance: Any = UNKNOWN_COVARIANCE
        if isinstance(answer, tuple | list) and len(answer) == 3:
            *answer, covariance = answer
        pair = pair_of_numbers(answer)
        if pair is None:
            return None
        answer = TrackingError(cte_m=pair[0], he_rad=pair[1], covariance=covariance)
    if flaw := answer.covariance_flaw:
        raise UsageError(f'perception: returned a {flaw}')
    return answer if answer.usable else NO_ESTIMATE


def perception_names() -> list[str]:
    """Names of perceptions: the truth, shipped networks, and those added by packages."""
    return names(PERCEPTIONS)


def make_perception(word_or_file: str) -> Perception:
    """Create a perception from a name or a file.

    Args:
        word_or_file: a name of :func:`perception_names`; or a ``.safetensors`` file with its model
            card next to it, an ``.onnx`` file with its description
            (:mod:`taxinet_ros.core.perception.onnx.sidecar`), or a function in a Python file
            (:mod:`taxinet_ros.core.user_code`).

    Raises:
        UsageError: an unknown name (the known ones are listed), or an unusable file or package.
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
        word_or_file: as for :func:`make_perception`.
        graph: the perception is for a ROS graph, so an external node is allowed too.

    Returns:
        Fingerprint of the perception; '' for an external node, which reports it later.

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


def find_domain(word_or_file: str) -> Domain | None:
    """What a network was trained in, by its card or description; None if they do not say.

    Raises:
        UsageError: they cannot be read.
    """
    extension = find(PERCEPTIONS, word_or_file)
    path = Path(word_or_file) if extension is None else extension.load()
    if isinstance(path, Path) and path.suffix == SUFFIX:
        return load_card(card_path(path)).domain
    if isinstance(path, Path) and path.suffix == ONNX_SUFFIX:
        return parse_sidecar(sidecar_path(path), NetworkFiles.read(path).description).domain
    return None


def network_doubts(word_or_file: str, scenes: Iterable[Scenario]) -> list[str]:
    """A warning if scenes are outside what a network was trained in.

    It names the shipped network for runways never seen where that one is what is missing.

    Raises:
        UsageError: its card or description cannot be read.
    """
    domain = find_domain(word_or_file)
    told = [] if domain is None else [scene.to_human() for scene in dict.fromkeys(scenes)]
    doubts = domain_doubts(word_or_file, domain, told)
    if doubts and (better := network_elsewhere(told)):
        doubts[0] += f'; {better} was trained for such'
    return doubts


def network_elsewhere(scenes: Sequence[Mapping[str, Any]]) -> str:
    """The shipped network for runways never seen, if scenes are for it and not for the default; ''.

    Args:
        scenes: in human units, by key.
    """
    asked = ((_AT_KMWH, True), (_ANYWHERE, False))
    fits = all(bool(domain_doubts(name, find_domain(name), scenes)) is out for name, out in asked)
    return _ANYWHERE if fits else ''


def _loaded(extension: Extension) -> Path | PluginCode | Perception:
    """Load what a name refers to: a network file, code of a package, or a built-in perception."""
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
    """Perception of a network file: safetensors weights, or a third-party ONNX after a trial."""
    if path.suffix == ONNX_SUFFIX:
        theirs, fingerprint = tried_network(path)
        view = theirs.sidecar.picture.view
        return NetworkPerception(theirs, word=word, fingerprint=fingerprint, view=view)
    model = load_model(path)
    ours = TaxiNet(ARCHITECTURES[model.card.architecture], model.weights)
    return NetworkPerception(
        ours, word=word, fingerprint=model.fingerprint, view=model.card.view
    )


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
        near = near_miss(text, names(PERCEPTIONS))
        raise UsageError(f'perception: {text!r} is unknown{near}; known: {words}')
    return path
