"""Evaluate a perception on single frames, by light and position."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.perception.weights import ERROR_QUANTITIES
from taxinet_ros.core.renderer import OURS, find_renderer
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import UsageError
from taxinet_ros.training.accuracy import error_statistics, half_width_95, in_card_units
from taxinet_ros.training.data.dataset import Progress, draw_scenes, no_progress
from taxinet_ros.training.data.image_folder import ImageFolder, open_folder
from taxinet_ros.training.data.photographs import photographs

WHOLE = 'all'

SLICES: dict[str, Callable[[Scenario], bool]] = {
    WHOLE: lambda scene: True,
    'late morning, fine': lambda s: _fine(s) and _late_morning(s),
    'early morning': lambda s: _fine(s) and s.time_of_day_s < 8.5 * 3600,
    'afternoon, clear': lambda s: s.clouds == 'clear' and s.time_of_day_s > 12 * 3600,
    'broken or stratus, dry': lambda s: s.clouds in ('broken', 'stratus') and s.rain_fraction == 0,
    'rain': lambda s: s.rain_fraction > 0,
    'crossing': lambda s: _late_morning(s) and _at_crossing(s),
}
"""Parts of S_falsif that the paper's analysis distinguishes, with their membership tests."""

_Frame = tuple[NDArray[np.uint8], TrackingError, Rig | None]
"""A picture, its label, and the rig that took it, if known."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SliceErrors:
    """Absolute errors on one part of the images.

    Attributes:
        name: name of the part.
        images: number of images in it.
        without_estimate: number of images without an estimate, which are left out of the errors.
        errors: as in a model card, by quantity and statistic; empty if there are none.
        half_widths: half width of the 95 % confidence interval of each mean, by quantity; None for
            fewer than two errors.
        mirrored: mean absolute errors that the estimates would have with the other sign, of the
            quantities that seem to have the wrong one (:func:`mirrored_errors`).
        guessed: mean absolute errors of always answering the median of the labels, of the
            quantities of which the estimates are no better.
    """

    name: str
    images: int
    without_estimate: int
    errors: dict[str, dict[str, float]]
    half_widths: dict[str, float | None]
    mirrored: dict[str, float] = field(default_factory=dict)
    guessed: dict[str, float] = field(default_factory=dict)


class _Measured(NamedTuple):
    """Estimates and truth of all images, each (N, 2) [m], [rad]; NaN where there is no estimate."""

    estimates: NDArray[np.float64]
    truth: NDArray[np.float64]

    @property
    def errors(self) -> NDArray[np.float64]:
        return np.abs(self.estimates - self.truth)


def _fine(s: Scenario) -> bool:
    return s.rain_fraction == 0 and s.clouds not in ('broken', 'stratus') and not _at_crossing(s)


def _late_morning(s: Scenario) -> bool:
    return 8.5 * 3600 <= s.time_of_day_s <= 12 * 3600


def _at_crossing(s: Scenario) -> bool:
    return 1300 < s.distance_m < 1600


def image_perception(word_or_file: str) -> Perception:
    """The perception of a word or file, which must use images.

    Raises:
        UsageError: it cannot be used, or uses no images.
    """
    perception = make_perception(word_or_file)
    if not perception.needs_image:
        raise UsageError(f'perception {word_or_file}: uses no camera image; name a network')
    return perception


def evaluate_program(
    perception: Perception,
    program: str,
    *,
    images: int = 2000,
    seed: int = 2,
    workers: int = 2,
    progress: Progress = no_progress,
    camera: str = OURS,
) -> list[SliceErrors]:
    """Evaluate a perception at the start of a program's scenes, in total and by :data:`SLICES`.

    Args:
        perception: perception of full frames, as in a run.
        program: word of a shipped Scenic program or path of one.
        images: number of scenes.
        seed: seed of the scenes; it must differ from that of the training.
        workers: number of rendering processes.
        progress: called in the stages ``scenes`` and ``images``.
        camera: who takes the pictures (:mod:`taxinet_ros.core.renderer`).

    Raises:
        UsageError: the program or the camera cannot be used.
        InfraError: a worker process died, or the simulator failed.
    """
    for name, value in (('images', images), ('workers', workers)):
        if value < 1:
            raise UsageError(f'evaluate: {name} is {value}; it has to be at least 1')
    find_renderer(camera)
    scenes = draw_scenes(program, seed=seed, images=images, progress=progress)
    taken = photographs(
        enumerate(scenes), _whole, varied=False, seed=seed, workers=workers, camera=camera
    )
    with closing(taken) as frames:
        measured = _measure(perception, frames, images, progress)
    rows = by_slice(measured.errors, scenes)
    return [_with_doubts(rows[0], measured), *rows[1:]]


def evaluate_folder(
    perception: Perception, folder: Path, progress: Progress = no_progress
) -> list[SliceErrors]:
    """Evaluate a perception on a folder of labelled images, in total only.

    Raises:
        UsageError: the folder, its labels or an image cannot be used.
    """
    opened = open_folder(folder, rigs=getattr(perception, 'view', None) is not None)
    measured = _measure(perception, _frames(opened), len(opened), progress)
    return [_with_doubts(_slice(WHOLE, measured.errors), measured)]


def _with_doubts(whole: SliceErrors, measured: _Measured) -> SliceErrors:
    """The errors of all images, with what seems to be wrong with the estimates."""
    mirrored, guessed = mirrored_errors(*measured), {}
    truth = measured.truth[~np.isnan(measured.estimates).any(axis=1)]
    if len(truth) >= _LEAST_IMAGES:
        means = in_card_units(np.abs(truth - np.median(truth, axis=0))).mean(axis=0)
        guessed = {
            quantity: round(float(mean), 4)
            for quantity, mean in zip(ERROR_QUANTITIES, means, strict=True)
            if quantity not in mirrored and whole.errors[quantity]['mae'] >= mean
        }
    return replace(whole, mirrored=mirrored, guessed=guessed)


_LEAST_IMAGES = 8
_MIRRORED_CORRELATION = -0.5


def mirrored_errors(
    estimates: NDArray[np.float64], truth: NDArray[np.float64]
) -> dict[str, float]:
    """Quantities whose estimates seem to have the wrong sign.

    A network that is merely bad has estimates that are uncorrelated with the truth. With the wrong
    sign they fall where the truth rises, and turned round they would be better.

    Args:
        estimates: (N, 2) [m], [rad]; NaN means no estimate.
        truth: the same of the labels.

    Returns:
        The mean absolute errors with the other sign, in the units of a model card, by quantity;
        none for fewer than eight estimates or a correlation above -0.5.
    """
    known = ~np.isnan(estimates).any(axis=1)
    found = {}
    if known.sum() < _LEAST_IMAGES:
        return {}
    errors, turned = (
        in_card_units(np.abs(sign * estimates[known] - truth[known])).mean(axis=0)
        for sign in (1.0, -1.0)
    )
    for column, quantity in enumerate(ERROR_QUANTITIES):
        guess, real = estimates[known, column], truth[known, column]
        if guess.std() == 0 or real.std() == 0:
            continue
        correlation = float(np.corrcoef(guess, real)[0, 1])
        if correlation <= _MIRRORED_CORRELATION and turned[column] < errors[column]:
            found[quantity] = round(float(turned[column]), 4)
    return found


def by_slice(errors: NDArray[np.float64], scenes: Sequence[Scenario]) -> list[SliceErrors]:
    """Errors of every part from absolute errors (N, 2) [m], [rad]; NaN means no estimate."""
    rows = []
    for name, belongs in SLICES.items():
        chosen = np.array([belongs(scene) for scene in scenes], bool)
        rows.append(_slice(name, errors[chosen]))
    return rows


def _slice(name: str, errors: NDArray[np.float64]) -> SliceErrors:
    known = errors[~np.isnan(errors).any(axis=1)]
    columns = zip(ERROR_QUANTITIES, in_card_units(known).T, strict=True)
    return SliceErrors(
        name=name,
        images=len(errors),
        without_estimate=len(errors) - len(known),
        errors=error_statistics(known) if len(known) else {},
        half_widths={quantity: half_width_95(column) for quantity, column in columns},
    )


def _measure(
    perception: Perception, frames: Iterable[_Frame], images: int, progress: Progress
) -> _Measured:
    measured = _Measured(np.full((images, 2), math.nan), np.full((images, 2), math.nan))
    current: Rig | None = None
    for row, (image, truth, rig) in enumerate(frames):
        if rig != current:
            perception.begin(rig)
            current = rig
        measured.truth[row] = truth.cte_m, truth.he_rad
        seen = perception.estimate(image, None)
        if seen.valid:
            measured.estimates[row] = seen.cte_m, seen.he_rad
        progress('images', row + 1, images)
    return measured


def _whole(index: int, image: NDArray[np.uint8], truth: TrackingError, rig: Rig) -> _Frame:
    return image, truth, rig


def _frames(folder: ImageFolder) -> Iterator[_Frame]:
    for row, frame in enumerate(folder.frames):
        yield folder.picture(row)[0], frame.truth, frame.rig
