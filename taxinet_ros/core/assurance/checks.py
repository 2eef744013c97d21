"""Four checks of a perception at run time, from the picture and the network alone.

Each gives a score, larger where it is less plausible that the estimate is right. None knows the
truth or the scene: what they use is the camera's frame, the estimate, the command that has been in
effect, and what the aircraft knows of itself (mounting and lens of the camera, own height).

* ``unfamiliar``: is the picture like those that the network is used to? Mahalanobis distance of
  mean colours and edge strengths of blocks, in their principal components.
* ``inconsistent``: do the last estimates follow from each other by the aircraft's kinematics?
* ``unseen``: is there a painted line where the estimate says that the centreline is? The estimated
  line is projected into the picture and compared with lines beside it.
* ``unmoved``: does the estimate move as it must if the picture is moved? The same network sees the
  picture as it would be from beside and turned, and its estimates should differ by just that (a
  metamorphic relation; Segura and others, IEEE Transactions on Software Engineering 42(9), 2016).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.camera.airframe import drawing
from taxinet_ros.core.camera.camera import pose
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.aircraft import measured_model
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import CONTROL_RATE
from taxinet_ros.core.types import NS_PER_S, AircraftState, TaxiCommand, TrackingError
from taxinet_ros.errors import UsageError

UNFAMILIAR: Final = 'unfamiliar'
INCONSISTENT: Final = 'inconsistent'
UNSEEN: Final = 'unseen'
UNMOVED: Final = 'unmoved'
CHECKS: Final = (UNFAMILIAR, INCONSISTENT, UNSEEN, UNMOVED)
"""Names of the checks, in the order of their scores."""

Vector = NDArray[np.float64]

LEAST_VARIANCE: Final = 1e-3
"""Added to the variance of the logarithms of a picture's features."""
LEAST_RESPONSE_M2: Final = 0.003
"""Added to the variance of responses [m^2]."""
_BLOCKS = (6, 4)
"""Columns and rows of blocks of the picture."""
FEATURES: Final = 4 * _BLOCKS[0] * _BLOCKS[1]
"""Number of features of a picture."""
COMPONENTS: Final = 5
"""Principal components of the features that are looked at."""
MOVES: Final = tuple(
    (left_m, math.radians(turn_deg))
    for left_m, turn_deg in ((0.0, 4.0), (0.0, -4.0), (1.5, 0.0), (-1.5, 0.0))
)
"""Moves of the aircraft, to the left [m] and turned left [rad], whose pictures are compared."""
RESPONSES: Final = 2 * len(MOVES)
"""Numbers by which an estimate responds to the moves."""
_LEVER_M = 10.0
"""An error of the heading counts as much as the line is aside so far ahead [m]."""
_FAR_M = 1000.0
"""Beyond this, a move aside does not count [m]."""
_WHOLE = np.empty((0, 0), np.uint16)
"""Fractions of the pixels to be read: none."""
_DARK = 3.0
"""Display codes added before the logarithm, so that noise in the dark does not count."""
_FINE = (72, 40)
"""Columns and rows of the reduced picture in which edges are measured."""
_PERIOD_S = CONTROL_PERIOD_NS / NS_PER_S
MEMORY: Final = 10
"""Steps over which estimates are compared: 1 s."""

_AHEAD_M = np.arange(7.0, 37.0, 1.5)
"""Distances along the estimated line at which the picture is read [m]."""
_STEP_M = 0.25
_HALF_M = 7.5
_ASIDE_M = np.arange(-_HALF_M, _HALF_M + _STEP_M / 2, _STEP_M)
"""Offsets from the estimated line, left positive [m]."""
_PAINT = 1
"""Half the width of a line of paint in offsets: together 0.75 m."""
_FLANK = 5
"""Reach of its surroundings in offsets: 1.25 m."""
_NEAR_M = 0.75
"""Within this of the estimated line its paint is taken for found [m]."""
_NEAR = np.abs(_ASIDE_M) <= _NEAR_M
_GREY = np.full(3, 1 / 3)
_LEAST_SEEN = 6
"""Distances at which an offset must be visible to be judged."""


def check_usual_rate(scenario: Scenario, who: str) -> None:
    """Refuse another control rate than the usual one, as scores are over a number of steps.

    Raises:
        UsageError: the scenario has another.
    """
    if scenario.period_ns != CONTROL_PERIOD_NS:
        raise UsageError(
            f'{who}: not with {CONTROL_RATE.key}={scenario.control_rate_hz:g}, as it judges over a '
            f'number of steps at {CONTROL_RATE.absent:g} Hz; leave one out, or take a monitor '
            'FILE.py:NAME'
        )


def features(image: NDArray[np.uint8]) -> Vector:
    """Features of a picture: logarithms of mean colours and edge strengths of its blocks.

    Light scales a picture as a whole, so in the logarithm dusk is as far away as it is dark.

    Args:
        image: (H, W, 3) uint8 RGB.

    Returns:
        (:data:`FEATURES`,) logarithms of display codes.
    """
    colours = cv2.resize(image, _BLOCKS, interpolation=cv2.INTER_AREA).astype(np.float64)
    fine = cv2.resize(image, _FINE, interpolation=cv2.INTER_AREA).astype(np.float64).mean(axis=2)
    edges = np.abs(np.diff(fine, axis=1, append=fine[:, -1:]))
    rows, columns = _BLOCKS[1], _BLOCKS[0]
    strength = edges.reshape(rows, _FINE[1] // rows, columns, _FINE[0] // columns).mean(axis=(1, 3))
    found: Vector = np.log(np.concatenate([colours.ravel(), strength.ravel()]) + _DARK)
    return found


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Usual:
    """Distribution of familiar values: of a picture's features, or of responses to moves.

    Attributes:
        mean: (n,).
        whitening: (k, n); it gives the principal components, of variance 1.
    """

    mean: Vector
    whitening: Vector

    def distance(self, values: Vector) -> float:
        """Mahalanobis distance within the principal components, over the root of their number.

        It is about 1 for familiar values, and infinite if one is not finite.
        """
        if not np.isfinite(values).all():
            return math.inf
        off = self.whitening @ (values - self.mean)
        return math.sqrt(float(off @ off) / len(off))


def fit_usual(values: Vector, components: int, least: float) -> Usual:
    """Fit a distribution.

    Of a picture's features only the first :data:`COMPONENTS` principal components count: what
    familiar pictures differ in, mostly light. In many more dimensions a large change in few of them
    would be lost.

    Args:
        values: (N, n).
        components: number of principal components, those of largest variance.
        least: added to each variance.
    """
    mean = values.mean(axis=0)
    variances, directions = np.linalg.eigh(np.cov(values, rowvar=False))
    scale = np.sqrt(variances[-components:] + least)
    return Usual(mean=mean, whitening=(directions[:, -components:] / scale).T)


@dataclass(frozen=True, kw_only=True, slots=True)
class Kinematics:
    """What estimates do from step to step while taxiing.

    Attributes:
        turn_per_m: change of heading per metre and tangent of the nose-wheel angle [rad/m].
        cte_spread_m, he_spread_rad: usual deviation from that within :data:`MEMORY` steps.
    """

    turn_per_m: float
    cte_spread_m: float
    he_spread_rad: float


class Consistency:
    """Compares the change of the estimates in a second with the one that kinematics gives.

    Model: the heading error grows by the path times ``turn_per_m`` tan(steering), the cross-track
    error by the path times the sine of the estimated heading error (kinematic bicycle).
    """

    def __init__(self) -> None:
        """Nothing is remembered."""
        self._seen: deque[tuple[float, float, float, float]] = deque(maxlen=MEMORY + 1)

    def deviations(
        self, estimate: TrackingError, command: TaxiCommand
    ) -> tuple[float, float, float] | None:
        """Deviations of the last second.

        Args:
            estimate: a usable estimate.
            command: command in effect since the last step.

        Returns:
            Change of CTE less that expected [m]; change of HE [rad]; and the path times tan of the
            steering that explains it [m]. None in the first second.
        """
        path_m = command.speed_mps * _PERIOD_S
        self._seen.append((
            estimate.cte_m, estimate.he_rad, path_m * math.sin(estimate.he_rad),
            path_m * math.tan(command.steering_rad),
        ))
        if len(self._seen) <= MEMORY:
            return None
        seen = np.array(self._seen)
        change = seen[-1, :2] - seen[0, :2]
        return (
            float(change[0] - seen[1:, 2].sum()), float(change[1]), float(seen[1:, 3].sum()),
        )

    def score(
        self, estimate: TrackingError, command: TaxiCommand, usual: Kinematics
    ) -> float:
        """Largest deviation of the last second in usual ones; 0 in the first second."""
        found = self.deviations(estimate, command)
        if found is None:
            return 0.0
        cte_m, turned_rad, steered_m = found
        he_rad = turned_rad - usual.turn_per_m * steered_m
        return max(abs(cte_m) / usual.cte_spread_m, abs(he_rad) / usual.he_spread_rad)


class Moves:
    """Pictures as they would be from beside and turned, and the estimates from them."""

    def __init__(self, scenario: Scenario, perceptions: Sequence[Perception]) -> None:
        """Take the camera's mounting and lens and the aircraft's attitude, not the scene.

        Args:
            scenario: names camera and aircraft.
            perceptions: the one that is judged, once for each of :data:`MOVES`, as one may remember
                the pictures it saw.
        """
        self._perceptions = perceptions
        self._places = [_moved_pixels(scenario, *move) for move in MOVES]
        for one in perceptions:
            one.begin(scenario.rig)

    def pictures(self, image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
        """The picture after each of :data:`MOVES`.

        The ground is taken as flat, and all else as far away. The aircraft's own parts stay; what
        they hid is left as it was, and what comes from beyond the edge repeats it.

        Args:
            image: (H, W, 3) uint8 RGB.
        """
        return [
            np.asarray(cv2.remap(image, places, _WHOLE, cv2.INTER_NEAREST), np.uint8)
            for places in self._places
        ]

    def responses(self, image: NDArray[np.uint8], estimate: TrackingError) -> Vector:
        """By how much the estimates differ from what they should be after each move.

        Args:
            image: (H, W, 3) uint8 RGB.
            estimate: the usable estimate for it.

        Returns:
            (:data:`RESPONSES`,) for each move the cross-track error [m], and the heading error as
            the line's place :data:`_LEVER_M` ahead [m]; infinite without an estimate.
        """
        found = np.full((len(MOVES), 2), math.inf)
        ways = zip(MOVES, self._perceptions, self.pictures(image), strict=True)
        for number, ((left_m, turn_rad), perception, moved) in enumerate(ways):
            told = perception.estimate(moved, None)
            if told.usable:
                aside_m = left_m * math.cos(estimate.he_rad)
                found[number] = (
                    told.cte_m - estimate.cte_m - aside_m,
                    (told.he_rad - estimate.he_rad - turn_rad) * _LEVER_M,
                )
        flat: Vector = found.ravel()
        return flat


def _moved_pixels(scenario: Scenario, left_m: float, turn_rad: float) -> NDArray[np.int16]:
    """For each pixel of the picture after a move, the pixel that shows it before.

    Returns:
        (H, W, 2) column and row.
    """
    camera = scenario.camera_model
    height, width = camera.shape[:2]
    settled = measured_model(scenario.aircraft_model).settled
    assert settled is not None

    def posed(y_m: float, yaw_rad: float) -> tuple[Vector, Vector]:
        _, to_optical, place = pose(AircraftState(
            x_m=0.0, y_m=y_m, z_m=settled.z_m, roll_rad=settled.roll_rad,
            pitch_rad=settled.pitch_rad, yaw_rad=yaw_rad, speed_mps=0.0, yaw_rate_radps=0.0,
        ), camera)
        return to_optical, place

    rows, columns = np.indices((height, width))
    x, y = camera.straight_rays(columns.ravel().astype(float), rows.ravel().astype(float))
    (now, place), (before, first) = posed(left_m, turn_rad), posed(0.0, 0.0)
    ways = np.stack([x, y, np.ones_like(x)], axis=1) @ now
    with np.errstate(divide='ignore', invalid='ignore'):
        reach = np.where(ways[:, 2] < 0, -place[2] / ways[:, 2], np.inf)
        near = reach * np.hypot(ways[:, 0], ways[:, 1]) < _FAR_M
        points = place + np.where(near, reach, 0.0)[:, None] * ways
        seen = np.where(near[:, None], (points - first) @ before.T, ways @ before.T)
        at = camera.pixels(seen)
    own = np.stack([columns.ravel(), rows.ravel()], axis=1)
    at = np.where(np.isfinite(at) & (seen[:, 2:] > 0), at, own)
    at = np.rint(np.clip(at, 0, (width - 1, height - 1))).astype(np.int16)
    hidden = _hidden(scenario)
    stays = hidden.ravel() | hidden[at[:, 1], at[:, 0]]
    found: NDArray[np.int16] = np.where(stays[:, None], own, at).astype(np.int16)
    return found.reshape(height, width, 2)


def _hidden(scenario: Scenario) -> NDArray[np.bool_]:
    """Where the aircraft's own parts are in the picture, (H, W)."""
    camera = scenario.camera_model
    hidden = np.zeros(camera.shape[:2], np.bool_)
    parts = drawing(scenario.aircraft_model, camera, camera.shape[:2])
    if parts is not None and not camera.distorts:
        hidden[parts.rows, parts.columns] = (parts.behind < 255).any(axis=2)
    return hidden


class Reprojection:
    """Looks for paint along the estimated centreline and along lines beside it."""

    def __init__(self, scenario: Scenario) -> None:
        """Take the camera's mounting and lens and the aircraft's height, not the scene.

        Args:
            scenario: names camera and aircraft.
        """
        self._camera = scenario.camera_model
        settled = measured_model(scenario.aircraft_model).settled
        assert settled is not None
        self._settled = settled
        self._hidden = _hidden(scenario)
        ahead, aside = np.meshgrid(_AHEAD_M, _ASIDE_M, indexing='ij')
        self._points = np.stack([ahead.ravel(), aside.ravel(), np.zeros(ahead.size)], axis=1)

    def profile(self, image: NDArray[np.uint8], estimate: TrackingError) -> Vector:
        """How much brighter lines parallel to the estimated one are than their surroundings.

        Args:
            image: (H, W, 3) uint8 RGB.
            estimate: a usable estimate.

        Returns:
            For each of the offsets, left positive, the mean contrast [display codes]; NaN where
            too little of it is visible.
        """
        state = AircraftState(
            x_m=0.0, y_m=float(estimate.cte_m), z_m=self._settled.z_m,
            roll_rad=self._settled.roll_rad, pitch_rad=self._settled.pitch_rad,
            yaw_rad=float(estimate.he_rad), speed_mps=0.0, yaw_rate_radps=0.0,
        )
        _, to_optical, place = pose(state, self._camera)
        seen = (self._points - place) @ to_optical.T
        height, width = self._camera.shape[:2]
        with np.errstate(invalid='ignore'):
            at = np.rint(self._camera.pixels(seen))
            inside = (
                (seen[:, 2] > 1.0) & (at[:, 0] >= 0) & (at[:, 0] < width)
                & (at[:, 1] >= 0) & (at[:, 1] < height)
            )
        u, v = np.where(inside[:, None], at, 0).astype(np.intp).T
        inside &= ~self._hidden[v, u]
        grey = image[v, u] @ _GREY
        grid = np.where(inside, grey, np.nan).reshape(len(_AHEAD_M), len(_ASIDE_M))
        contrast = _contrast(grid)
        known = np.isfinite(contrast)
        count = known.sum(axis=0)
        total = np.where(known, contrast, 0.0).sum(axis=0)
        return np.where(count >= _LEAST_SEEN, total / np.maximum(count, 1), np.nan)

    def score(self, image: NDArray[np.uint8], estimate: TrackingError) -> float:
        """How much better a line aside is seen than the estimated one, in usual variations.

        0 if the best line is within :data:`_NEAR_M`, or if too little is visible.
        """
        profile = self.profile(image, estimate)
        seen = np.isfinite(profile)
        here = profile[seen & _NEAR]
        if seen.sum() < len(profile) // 3 or not len(here):
            return 0.0
        known = profile[seen]
        spread = np.median(np.abs(known - np.median(known)))
        return float((known.max() - here.max()) / max(spread, 0.5))


def _contrast(grid: Vector) -> Vector:
    """Mean of the paint's width less the mean of what is beside it, along the rows; NaN at ends."""
    known = np.isfinite(grid)
    sums = np.cumsum(np.pad(np.where(known, grid, 0.0), ((0, 0), (1, 0))), axis=1)
    counts = np.cumsum(np.pad(known, ((0, 0), (1, 0))), axis=1)
    size = grid.shape[1]
    inner = np.arange(_FLANK, size - _FLANK)

    def mean(low: int, high: int) -> Vector:
        """Mean of columns c + low to c + high, both included, for each inner column c."""
        first, last = inner + low, inner + high + 1
        whole = counts[:, last] - counts[:, first] == high - low + 1
        found: Vector = np.where(
            whole, (sums[:, last] - sums[:, first]) / (high - low + 1), np.nan
        )
        return found

    paint = mean(-_PAINT, _PAINT)
    beside = np.maximum(mean(-_FLANK, -_PAINT - 1), mean(_PAINT + 1, _FLANK))
    out = np.full(grid.shape, np.nan)
    out[:, _FLANK:size - _FLANK] = paint - beside
    return out
