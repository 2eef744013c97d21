"""Monitors of a perception at run time: the shipped one with its calibration, and your own.

A monitor sees each picture with the estimate made from it and the command that has been in effect,
and gives scores relative to their thresholds: 1 or more raises the alarm.

The thresholds of the shipped monitor are conformal (Vovk, Gammerman and Shafer, *Algorithmic
Learning in a Random World*, 2005, chapter 2): of n satisfied runs, the largest score of each run is
taken, and the threshold is the ceil((n + 1)(1 - a))-th smallest. A further satisfied run of the
same distribution exceeds it with probability a at most, whatever the distribution. With a quarter
of the chosen rate for each of the four checks, their union keeps to the rate. That is an average
over calibrations: of one, a check's probability of an alarm is distributed as Beta(n + 1 - k, k), k
the rank of its threshold.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.assurance.checks import (
    CHECKS,
    COMPONENTS,
    FEATURES,
    MOVES,
    RESPONSES,
    Consistency,
    Kinematics,
    Moves,
    Reprojection,
    Usual,
    check_usual_rate,
    features,
)
from taxinet_ros.core.perception.perception import Perception, check_perception, make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TaxiCommand, TrackingError
from taxinet_ros.core.user_code import RunCode, UserCode, find_user_code, names_user_code
from taxinet_ros.errors import UsageError
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file

SUFFIX: Final = '.npz'
"""Suffix of calibration files."""
SUSTAINED: Final = 5
"""Steps (0.5 s) for which a score has to stay above its threshold: a single frame is no alarm."""
NO_ESTIMATE: Final = 'no estimate'
"""Reason of an alarm where there is no usable estimate."""
SIGMA: Final = 'sigma:'
"""Monitor of what the estimates claim of themselves, ``sigma:METRES``."""
_FOLDER = Path(__file__).parent / 'calibrations'
_VERSION = 2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Seen:
    """What a monitor sees in a control step.

    Attributes:
        image: the camera's frame, (H, W, 3) uint8 RGB.
        estimate: the perception's estimate for it.
        command: command since the last step.
    """

    image: NDArray[np.uint8]
    estimate: TrackingError
    command: TaxiCommand


class RuntimeMonitor(Protocol):
    """Judges each estimate of a run.

    Attributes:
        word: how it is named in bags.
        fingerprint: SHA-256 of what determines its scores.
    """

    word: str
    fingerprint: str

    def begin(self, scenario: Scenario) -> None:
        """Reset, before each run.

        Args:
            scenario: names camera and aircraft; a monitor uses nothing else of it.
        """
        ...

    def scores(self, seen: Seen) -> Mapping[str, float]:
        """Scores by check, over their thresholds; 1 or more raises the alarm."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """What is usual for a perception.

    Attributes:
        familiar: of the features of its pictures.
        kinematics: of its estimates from step to step.
        moved: of its responses to moves of the picture.
    """

    familiar: Usual
    kinematics: Kinematics
    moved: Usual


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """What the shipped monitor knows of a perception, made by ``taxinet assure calibrate``.

    Attributes:
        perception, perception_sha256: the perception.
        source: its name, or the path of its file.
        program, seed: the scenes of the runs.
        runs: number of satisfied runs that set the thresholds.
        rate: largest share of satisfied runs with an alarm, on average over calibrations.
        thresholds: by check.
        fitted: what is usual.
    """

    perception: str
    perception_sha256: str
    source: str
    program: str
    seed: int
    runs: int
    rate: float
    thresholds: Mapping[str, float]
    fitted: Fitted

    def doubts(self, monitor: str, perception: str, sha256: str) -> list[str]:
        """A warning if it watches another perception than its own, whose errors it does not know.

        Args:
            monitor: word of the monitor.
            perception: word of the perception that it watches.
            sha256: its fingerprint.
        """
        if sha256 == self.perception_sha256:
            return []
        return [
            f'monitor {monitor} is calibrated for {self.perception}, and watches {perception}, '
            'whose usual errors it does not know: it may give alarms often, or never; calibrate '
            f'one: taxinet assure calibrate PROGRAM --perception {perception}'
        ]

    def to_bytes(self) -> bytes:
        """Content of a calibration file; equal calibrations give equal bytes."""
        told = {
            'version': _VERSION, 'perception': self.perception,
            'perception_sha256': self.perception_sha256, 'source': self.source,
            'program': self.program,
            'seed': self.seed, 'runs': self.runs, 'rate': self.rate,
            'thresholds': dict(self.thresholds),
            'kinematics': dataclasses.asdict(self.fitted.kinematics),
        }
        packed = io.BytesIO()
        np.savez(
            packed, about=np.array(json.dumps(told, sort_keys=True)),
            mean=self.fitted.familiar.mean,
            whitening=self.fitted.familiar.whitening.astype(np.float32),
            moved_mean=self.fitted.moved.mean, moved_whitening=self.fitted.moved.whitening,
        )
        return packed.getvalue()


def read_calibration(path: Path) -> tuple[Calibration, str]:
    """Read a calibration and the SHA-256 of its file.

    Raises:
        UsageError: the file cannot be read, or is no calibration.
    """
    try:
        content = read_file(path, MAX_TEXT_BYTES)
    except OSError as error:
        raise UsageError(f'monitor {path}: {error.strerror}') from error
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as packed:
            told: dict[str, Any] = json.loads(str(packed['about']))
            if told.get('version') != _VERSION:
                raise UsageError(f'monitor {path}: made by another version; calibrate it again')
            familiar, moved = (
                Usual(
                    mean=packed[f'{name}mean'].astype(np.float64),
                    whitening=packed[f'{name}whitening'].astype(np.float64),
                ) for name in ('', 'moved_')
            )
        del told['version']
        kinematics = Kinematics(**told.pop('kinematics'))
        found = Calibration(
            **told, fitted=Fitted(familiar=familiar, kinematics=kinematics, moved=moved)
        )
        _check(found)
    except UsageError:
        raise
    except Exception as error:  # zipfile, zlib, numpy and json have one of their own each
        raise UsageError(
            f'monitor {path}: no calibration: {error}; `taxinet assure calibrate` makes one'
        ) from error
    return found, hashlib.sha256(content).hexdigest()


def _check(found: Calibration) -> None:
    fitted = found.fitted
    kinematics = dataclasses.asdict(fitted.kinematics)
    numbers = [*found.thresholds.values(), *kinematics.values()]
    spreads = fitted.kinematics.cte_spread_m, fitted.kinematics.he_spread_rad
    if set(found.thresholds) != set(CHECKS):
        raise ValueError(f'thresholds of {sorted(found.thresholds)}')
    shapes = ('familiar', fitted.familiar, COMPONENTS, FEATURES), (
        'moved', fitted.moved, RESPONSES, RESPONSES
    )
    for name, usual, components, size in shapes:
        if usual.mean.shape != (size,) or usual.whitening.shape != (components, size):
            raise ValueError(f'{name}: its shape is {usual.whitening.shape}')
        if not (np.isfinite(usual.mean).all() and np.isfinite(usual.whitening).all()):
            raise ValueError('a number is not finite')
    if not all(map(math.isfinite, numbers)):
        raise ValueError('a number is not finite')
    if min(*found.thresholds.values(), *spreads) <= 0:
        raise ValueError('a threshold is not positive')


def conformal_rank(n: int, rate: float) -> int:
    """Rank of the threshold among the ``n`` values of :func:`conformal_threshold`."""
    return math.ceil((n + 1) * (1 - rate) - 1e-9)


def conformal_threshold(largest: Sequence[float], rate: float) -> float:
    """Threshold that a further exchangeable value exceeds with probability ``rate`` at most.

    Args:
        largest: one value per run.
        rate: in (0, 1).

    Raises:
        UsageError: there are too few values for this rate.
    """
    n = len(largest)
    rank = conformal_rank(n, rate)
    if rank > n:
        needed = math.ceil(1 / rate - 1 - 1e-9)
        raise UsageError(
            f'a rate of {rate:g} per check needs {needed:,} satisfied runs, there are {n:,}; '
            'use more runs or a larger rate'
        )
    return sorted(largest)[rank - 1]


class RawChecks:
    """The unscaled scores of the checks, sustained over :data:`SUSTAINED` steps."""

    def __init__(
        self, fitted: Fitted, scenario: Scenario, perceptions: Sequence[Perception]
    ) -> None:
        """Begin a run; the perceptions are those for :class:`.Moves`."""
        check_usual_rate(scenario, 'monitor')
        self._fitted = fitted
        self._consistency, self._reprojection = Consistency(), Reprojection(scenario)
        self._moves = Moves(scenario, perceptions)
        self._recent: deque[tuple[float, ...]] = deque(maxlen=SUSTAINED)

    def scores(self, seen: Seen) -> tuple[float, ...] | None:
        """Least score of the last steps, by check; None if they all lacked an estimate.

        0 in the first steps. A step without a usable estimate counts as implausible in all checks
        of the estimate.
        """
        fitted = self._fitted
        picture = fitted.familiar.distance(features(seen.image))
        if seen.estimate.usable:
            now = (
                picture,
                self._consistency.score(seen.estimate, seen.command, fitted.kinematics),
                self._reprojection.score(seen.image, seen.estimate),
                fitted.moved.distance(self._moves.responses(seen.image, seen.estimate)),
            )
        else:
            self._consistency = Consistency()
            now = (picture, math.inf, math.inf, math.inf)
        self._recent.append(now)
        if len(self._recent) < SUSTAINED:
            return (0.0,) * len(CHECKS)
        found = tuple(min(values) for values in zip(*self._recent, strict=True))
        return None if math.isinf(found[1]) else found


class CalibratedMonitor(RuntimeMonitor):
    """The shipped monitor: four checks with calibrated thresholds."""

    def __init__(
        self, word: str, calibration: Calibration, fingerprint: str,
        perceptions: Sequence[Perception],
    ) -> None:
        """``word`` and ``fingerprint``: see :class:`RuntimeMonitor`.

        The perceptions are those for :class:`.Moves`.
        """
        self.word, self.fingerprint = word, fingerprint
        self.calibration = calibration
        self._perceptions = perceptions
        self._checks: RawChecks | None = None

    def begin(self, scenario: Scenario) -> None:
        """Reset."""
        self._checks = RawChecks(self.calibration.fitted, scenario, self._perceptions)

    def scores(self, seen: Seen) -> Mapping[str, float]:
        """Scores over their thresholds, by check; infinity without an estimate."""
        assert self._checks is not None
        found = self._checks.scores(seen)
        if found is None:
            return {NO_ESTIMATE: math.inf}
        limits = self.calibration.thresholds
        # An alarm is a score beyond the threshold, which itself was seen in a satisfied run.
        return {
            name: math.nextafter(value / limits[name], -math.inf)
            for name, value in zip(CHECKS, found, strict=True)
        }


class SigmaMonitor(RuntimeMonitor):
    """Is the standard deviation that estimates claim for the cross-track error below a limit?

    One without an estimate, or that claims none, counts as infinite.
    """

    def __init__(self, word: str) -> None:
        """``word``: ``sigma:METRES``; a UsageError without a limit above 0."""
        try:
            self._limit_m = float(word.removeprefix(SIGMA))
        except ValueError:
            self._limit_m = 0.0
        if not 0 < self._limit_m < math.inf:
            raise UsageError(f'monitor {word}: needs a limit above 0 m, as in {SIGMA}1.5')
        self.word, self.fingerprint = word, hashlib.sha256(word.encode()).hexdigest()
        self._recent: deque[float] = deque(maxlen=SUSTAINED)

    def begin(self, scenario: Scenario) -> None:
        """Reset."""
        check_usual_rate(scenario, f'monitor {self.word}')
        self._recent.clear()

    def scores(self, seen: Seen) -> Mapping[str, float]:
        """The least standard deviation of the last steps over the limit; 0 in the first steps."""
        sigma_m = seen.estimate.cte_sigma_m if seen.estimate.usable else math.nan
        self._recent.append(math.inf if math.isnan(sigma_m) else sigma_m)
        if len(self._recent) < SUSTAINED:
            return {'uncertain': 0.0}
        score = min(self._recent) / self._limit_m
        return {'uncertain': score if math.isinf(score) else math.nextafter(score, -math.inf)}


class UserMonitor(RuntimeMonitor):
    """A user's function of :class:`Seen`: a score, 1 or more raises the alarm."""

    def __init__(self, code: UserCode) -> None:
        """Load the function.

        Raises:
            UsageError: the file's code fails.
        """
        self.word, self.fingerprint = code.word, code.sha256
        self._name, self._run = code.name, RunCode(code)

    def begin(self, scenario: Scenario) -> None:
        """Reset to the initial state."""
        self._run.begin()

    def scores(self, seen: Seen) -> Mapping[str, float]:
        """The function's score, by its name."""
        own = dataclasses.replace(seen, image=seen.image.copy())
        return {self._name: self._run.answer(own, _read_score, 'a number that is not NaN')}


def _read_score(answer: Any) -> float | None:
    if isinstance(answer, bool | np.bool_ | str | bytes):
        return None
    try:
        number = float(answer)
    except (TypeError, ValueError):
        return None
    return None if math.isnan(number) else number


def monitor_names() -> list[str]:
    """Perceptions with a shipped calibration."""
    return sorted(path.stem for path in _FOLDER.glob(f'*{SUFFIX}'))


def is_monitor_name(word: str) -> bool:
    """Whether a word alone names a monitor, without a path."""
    return word.startswith(SIGMA) or word in monitor_names()


def make_monitor(word: str) -> RuntimeMonitor:
    """Create a monitor.

    Args:
        word: a name of :func:`monitor_names`, a calibration file, ``FILE.py:NAME``, or
            ``sigma:METRES``.

    Raises:
        UsageError: unknown, or it cannot be used.
    """
    if word.startswith(SIGMA):
        return SigmaMonitor(word)
    if names_user_code(word):
        return UserMonitor(find_user_code(word, 'monitor'))
    path = _calibration_path(word)
    calibration, sha256 = read_calibration(path)
    shipped = path.parent == _FOLDER
    perceptions = make_perceptions(calibration.source)
    if perceptions[0].fingerprint != calibration.perception_sha256:
        raise UsageError(
            f'monitor {word}: {calibration.source} has changed since; calibrate it again'
        )
    return CalibratedMonitor(
        word if shipped else 'calibrated', calibration, sha256, perceptions
    )


def make_perceptions(word_or_file: str) -> list[Perception]:
    """The perceptions for :class:`.Moves`.

    Raises:
        UsageError: as :func:`.make_perception`.
    """
    return [make_perception(word_or_file) for _ in MOVES]


def check_monitor(word: str) -> str:
    """Fingerprint of a monitor, without running user code.

    Raises:
        UsageError: as :func:`make_monitor`.
    """
    if word.startswith(SIGMA):
        return SigmaMonitor(word).fingerprint
    if names_user_code(word):
        return find_user_code(word, 'monitor').sha256
    return read_calibration(_calibration_path(word))[1]


def monitor_doubts(word: str, perception: str) -> list[str]:
    """Warnings on a monitor that watches a perception (:meth:`Calibration.doubts`).

    Args:
        word: as for :func:`make_monitor`.
        perception: word or file; a node tells only later what it is, so there is no warning.

    Raises:
        UsageError: as :func:`check_monitor` and :func:`.check_perception`.
    """
    if names_user_code(word) or word.startswith(SIGMA):
        return []
    calibration, _ = read_calibration(_calibration_path(word))
    sha256 = check_perception(perception, graph=True)
    return calibration.doubts(word, perception, sha256) if sha256 else []


def check_monitor_rate(word: str, scenes: Iterable[Scenario]) -> None:
    """Refuse a shipped or calibrated monitor in scenes with another control rate than the usual.

    Raises:
        UsageError: there is such a scene.
    """
    for scene in () if names_user_code(word) else scenes:
        check_usual_rate(scene, f'monitor {word}')


def _calibration_path(word: str) -> Path:
    if word in monitor_names():
        return _FOLDER / f'{word}{SUFFIX}'
    if word.endswith(SUFFIX):
        return Path(word)
    known = ', '.join([*monitor_names(), f'a {SUFFIX} file of `taxinet assure calibrate`',
                       f'{SIGMA}METRES', 'or FILE.py:NAME'])
    raise UsageError(f'monitor: {word!r} is unknown; known: {known}')
