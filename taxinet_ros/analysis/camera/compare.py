"""Evaluate a perception on labelled frames, and render the same poses with our camera."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.analysis.camera.sheets import Picture, contact_sheet
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.perception.labelled_frames import LabelledFrame
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import clock_words
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import UsageError

PAIRS = 8
LIGHT: Mapping[str, object] = {'time_of_day_h': 9 + 4 / 60, 'clouds': 'clear'}
"""Default light of our pictures: that of the published X-Plane frames."""

_RESOLUTION = 1e-9
"""Smaller differences, in metres or degrees, count as zero."""

_RESAMPLES = 2000
_PAIRS_IN_A_ROW = 2


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameError:
    """One frame: the label, the estimate and their difference; None without an estimate.

    Heading errors are in degrees, nose left positive; an error is estimate minus label.
    """

    image: str
    cte_m: float
    heading_error_deg: float
    cte_estimate_m: float | None = None
    heading_error_estimate_deg: float | None = None
    cte_error_m: float | None = None
    heading_error_error_deg: float | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class QuantityErrors:
    """Errors of one quantity over the frames with an estimate, in its unit.

    Attributes:
        mae: mean absolute error.
        mae_95: its 95 % interval, by bootstrap over frames as if they were independent.
        bias: mean error, estimate minus label.
        correlation: of estimates and labels; None if one of them does not vary.
        mean_predictor_mae: error of a constant estimate, the mean of these labels.
    """

    mae: float | None
    mae_95: tuple[float, float] | None
    bias: float | None
    correlation: float | None
    mean_predictor_mae: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """Errors over all frames and of each frame."""

    cte_m: QuantityErrors
    heading_error_deg: QuantityErrors
    frames: tuple[FrameError, ...]

    @property
    def without_estimate(self) -> int:
        """Number of frames without an estimate."""
        return sum(frame.cte_estimate_m is None for frame in self.frames)

    def to_dict(self) -> dict[str, object]:
        """Summary figures, then the frames; ready for JSON."""
        flat: dict[str, object] = {
            'frame_count': len(self.frames), 'without_estimate': self.without_estimate,
        }
        for name, unit in (('cte', 'm'), ('heading_error', 'deg')):
            errors: QuantityErrors = getattr(self, f'{name}_{unit}')
            flat[f'{name}_mae_{unit}'] = errors.mae
            flat[f'{name}_mae_{unit}_95'] = errors.mae_95
            flat[f'{name}_bias_{unit}'] = errors.bias
            flat[f'{name}_correlation'] = errors.correlation
            flat[f'mean_predictor_{name}_mae_{unit}'] = errors.mean_predictor_mae
        return {**flat, 'frames': [asdict(frame) for frame in self.frames]}


def compare_frames(
    frames: Iterable[LabelledFrame], perception: Perception, *, seed: int = 0
) -> Comparison:
    """Evaluate a perception on frames against their labels.

    Args:
        frames: at least one.
        perception: perception that uses pictures.
        seed: seed of the bootstrap.

    Raises:
        UsageError: a picture cannot be read.
    """
    rows = tuple(_frame_error(frame, perception) for frame in frames)
    answered = [row for row in rows if row.cte_estimate_m is not None]
    numbers = np.array([
        (row.cte_m, row.cte_estimate_m, row.heading_error_deg, row.heading_error_estimate_deg)
        for row in answered
    ], float).reshape(-1, 4)
    return Comparison(
        cte_m=quantity_errors(numbers[:, 0], numbers[:, 1], seed=seed),
        heading_error_deg=quantity_errors(numbers[:, 2], numbers[:, 3], seed=seed),
        frames=rows,
    )


def _frame_error(frame: LabelledFrame, perception: Perception) -> FrameError:
    seen = perception.estimate(frame.picture(), None)
    cte_m, heading_deg = frame.truth.cte_m, math.degrees(frame.truth.he_rad)
    if not seen.usable:
        return FrameError(image=frame.image, cte_m=cte_m, heading_error_deg=heading_deg)
    seen_deg = math.degrees(seen.he_rad)
    return FrameError(
        image=frame.image, cte_m=cte_m, heading_error_deg=heading_deg,
        cte_estimate_m=seen.cte_m, heading_error_estimate_deg=seen_deg,
        cte_error_m=seen.cte_m - cte_m, heading_error_error_deg=seen_deg - heading_deg,
    )


def quantity_errors(
    labels: NDArray[np.float64], estimates: NDArray[np.float64], *, seed: int = 0
) -> QuantityErrors:
    """Errors of ``estimates`` (N,) against ``labels`` (N,); all None if N is 0."""
    if not len(labels):
        return QuantityErrors(
            mae=None, mae_95=None, bias=None, correlation=None, mean_predictor_mae=None
        )
    errors = estimates - labels
    low, high = _interval(np.abs(errors), np.random.default_rng(seed))
    # Without a numerically significant variation there is no meaningful correlation.
    vary = min(float(np.ptp(labels)), float(np.ptp(estimates))) > _RESOLUTION
    return QuantityErrors(
        mae=float(np.abs(errors).mean()),
        mae_95=(low, high),
        bias=float(errors.mean()),
        correlation=float(np.corrcoef(labels, estimates)[0, 1]) if vary else None,
        mean_predictor_mae=float(np.abs(labels - labels.mean()).mean()),
    )


def _interval(values: NDArray[np.float64], rng: np.random.Generator) -> tuple[float, float]:
    """Percentile bootstrap of the mean (Efron and Tibshirani, An Introduction to the Bootstrap)."""
    count = len(values)
    means = [values[rng.integers(0, count, count)].mean() for _ in range(_RESAMPLES)]
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def spread_out(frames: Sequence[LabelledFrame], count: int = PAIRS) -> list[LabelledFrame]:
    """Up to ``count`` frames far apart in pose, in their own order, including the first frame.

    Each next one is the farthest from all chosen so far, with standardised coordinates.
    """
    poses = np.array([(f.truth.cte_m, f.truth.he_rad, f.distance_m) for f in frames])
    poses /= np.maximum(poses.std(axis=0), 1e-9)
    chosen = [0]
    while len(chosen) < min(count, len(frames)):
        gaps = np.linalg.norm(poses[:, None] - poses[chosen][None], axis=2).min(axis=1)
        gaps[chosen] = -1
        chosen.append(int(np.argmax(gaps)))
    return [frames[index] for index in sorted(chosen)]


def comparison_scenes(
    frames: Sequence[LabelledFrame], settings: Mapping[str, object], distance_offset_m: float
) -> list[tuple[LabelledFrame, Scenario]]:
    """Frames for the sheet, each with our scene of the same pose.

    Args:
        frames: all frames; those that are not on our runway are skipped.
        settings: light and weather in human keys and units; they override :data:`LIGHT`.
        distance_offset_m: our distance past the threshold minus theirs [m].

    Raises:
        UsageError: settings are invalid, or no frame is on our runway.
    """
    base = {**LIGHT, **settings}
    scenario_from_human(base)
    scenes, reason = {}, ''
    for frame in frames:
        pose = {
            'cross_track_m': frame.truth.cte_m, 'heading_deg': math.degrees(frame.truth.he_rad),
            'distance_m': frame.distance_m + distance_offset_m,
        }
        try:
            scenes[frame] = scenario_from_human({**base, **pose})
        except UsageError as error:
            reason = f'{frame.image}: {str(error).removeprefix("scenario: ")}'
    if not scenes:
        raise UsageError(
            f'no frame lies on our runway (first: {reason}); see --distance-offset'
        )
    return [(frame, scenes[frame]) for frame in spread_out(list(scenes))]


def comparison_sheet(
    scenes: Sequence[tuple[LabelledFrame, Scenario]], perception: Perception, path: Path
) -> None:
    """Draw labelled frames beside our frames of the same poses, with the estimates in each.

    Args:
        scenes: from :func:`comparison_scenes`.
        perception: perception that uses pictures.
        path: PNG file to write.

    Raises:
        UsageError: a picture cannot be read.
    """
    tiles: list[tuple[Picture, str]] = []
    for frame, scene in scenes:
        theirs, ours = frame.picture(), Camera(scene).render(Aircraft(scene).state, 0)
        names = (
            f'theirs: {frame.image}, at {frame.distance_m:.0f} m',
            f'ours: {scene.distance_m:.0f} m past the threshold',
        )
        for picture, name in zip((theirs, ours), names, strict=True):
            seen = perception.estimate(picture, None)
            estimate = _words(seen) if seen.usable else 'no estimate'
            tiles.append((
                picture, f'{name}\ntruth: {_words(frame.truth)}\n{perception.word}: {estimate}',
            ))
    light = scenes[0][1]
    contact_sheet(
        tiles, 2 * _PAIRS_IN_A_ROW, path, group=2,
        title=f'Labelled frames and our camera at the same poses; ours on {light.date}, '
        f'{clock_words(light.time_of_day_s / 3600)}, {light.clouds}',
    )


def _words(pose: TrackingError) -> str:
    return f'CTE {pose.cte_m:+.1f} m, HE {math.degrees(pose.he_rad):+.1f}°'
