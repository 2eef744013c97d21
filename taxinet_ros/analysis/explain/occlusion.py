"""Occlusion sensitivity: change of an estimate when a patch of the picture is covered.

The method (Zeiler and Fergus, Visualizing and understanding convolutional networks, ECCV 2014,
section 4.2) only needs the network's outputs. Instead of their grey square a patch shows the
blurred picture with soft edges: it keeps the local brightness, removes details and adds no edges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.analysis.explain.track import Estimator, Floats, Frame, heading_asked_rad
from taxinet_ros.core.motion.controller import SteeringGains

PATCH_PX = 30
"""Side of a patch [px]: the width of the centreline at 7 m."""

STRIDE_PX = 10
"""Distance between patches [px]: 836 evaluations per map, about a second with our networks."""

_SOFT_PX = 6
_ROWS = ('upper', '', 'lower')
_COLUMNS = ('left', 'middle', 'right')


@dataclass(frozen=True, kw_only=True, eq=False)
class OcclusionMap:
    """Change of the estimate by covered place.

    Attributes:
        cte_m: change of the estimated cross-track error per cell of :data:`STRIDE_PX`, the mean
            over the patches that cover the cell [m].
        he_rad: the same for the heading error [rad].
        weight_rad: effect of a cell on the heading requested by the steering law [rad].
        lost: number of patches whose occlusion leaves the network without an estimate.
    """

    cte_m: Floats
    he_rad: Floats
    weight_rad: Floats
    lost: int

    @property
    def region(self) -> tuple[str, float]:
        """Name of the most important ninth of the picture, and its share of the effect.

        The share is 0 if there is no effect.
        """
        return _ninth(self.weight_rad)

    def share(self, mask: NDArray[np.bool_]) -> float:
        """Share of the effect within ``mask`` (H, W) of the picture."""
        weight = _in_pixels(self.weight_rad, mask.shape)
        total = float(weight.sum())
        return float(weight[mask].sum()) / total if total > 0 else 0.0


def _ninth(weight: Floats) -> tuple[str, float]:
    """Name of the ninth of the picture with most of the weight, and its share of all."""
    parts = {
        (row, column): float(cell.sum())
        for row, band in enumerate(np.array_split(weight, 3, axis=0))
        for column, cell in enumerate(np.array_split(band, 3, axis=1))
    }
    row, column = max(parts, key=lambda place: parts[place])
    total = sum(parts.values())
    words = f'{_ROWS[row]} {_COLUMNS[column]}'.strip()
    return ('centre' if words == 'middle' else words,
            parts[row, column] / total if total > 0 else 0.0)


def occlusion_map(look: Estimator, image: Frame, gains: SteeringGains) -> OcclusionMap:
    """Cover a frame patch by patch and evaluate the network on each.

    Args:
        look: the network; equal frames must give equal estimates.
        image: camera frame, (H, W, 3) uint8 RGB.
        gains: gains of the steering law, which weigh metres against radians; beyond its intercept
            limit metres have no effect.
    """
    whole = look(image)
    whole_rad = heading_asked_rad(whole.cte_m, whole.he_rad, gains)
    height, width = image.shape[:2]
    cells = (-(-height // STRIDE_PX), -(-width // STRIDE_PX))
    sums, counts, lost = np.zeros((*cells, 3)), np.zeros(cells), 0
    covered = np.asarray(cv2.GaussianBlur(image, (0, 0), sigmaX=PATCH_PX / 2), np.uint8)
    span, soft = PATCH_PX // STRIDE_PX, _soft_patch()
    for row, column in product(range(1 - span, cells[0]), range(1 - span, cells[1])):
        seen = look(_cover(image, covered, soft, row * STRIDE_PX, column * STRIDE_PX))
        part = (slice(max(row, 0), row + span), slice(max(column, 0), column + span))
        if not (seen.usable and whole.usable):
            lost += 1
            continue
        cte_m, he_rad = seen.cte_m - whole.cte_m, seen.he_rad - whole.he_rad
        asked_rad = heading_asked_rad(seen.cte_m, seen.he_rad, gains)
        sums[part] += (cte_m, he_rad, abs(asked_rad - whole_rad))
        counts[part] += 1
    mean = sums / np.maximum(counts, 1)[:, :, np.newaxis]
    return OcclusionMap(
        cte_m=mean[:, :, 0], he_rad=mean[:, :, 1], weight_rad=mean[:, :, 2], lost=lost)


def changed_pixels(one: Frame, other: Frame, levels: int = 4) -> NDArray[np.bool_]:
    """Mask of the pixels where frames differ by more than ``levels`` in some colour, (H, W)."""
    return np.asarray(cv2.absdiff(one, other).max(axis=2) > levels, np.bool_)


def _cover(
    image: Frame, covered: Frame, soft: NDArray[np.float32], top: int, left: int
) -> Frame:
    """The frame with a patch at (top, left), which may extend beyond its borders."""
    height, width = image.shape[:2]
    rows = slice(max(top, 0), min(top + PATCH_PX, height))
    columns = slice(max(left, 0), min(left + PATCH_PX, width))
    share = soft[rows.start - top:rows.stop - top, columns.start - left:columns.stop - left]
    picture = image.copy()
    there = picture[rows, columns].astype(np.float32)
    there += share * (covered[rows, columns] - there)
    picture[rows, columns] = np.rint(there).astype(np.uint8)
    return picture


def _soft_patch() -> NDArray[np.float32]:
    """Opacity of a patch, 0..1, (PATCH_PX, PATCH_PX, 1): 1 in the middle, less at the edges."""
    place = np.arange(PATCH_PX)
    ramp = np.minimum((np.minimum(place, place[::-1]) + 1) / _SOFT_PX, 1.0)
    return np.outer(ramp, ramp).astype(np.float32)[:, :, np.newaxis]


def _in_pixels(cells: Floats, shape: tuple[int, ...]) -> Floats:
    square = np.ones((STRIDE_PX, STRIDE_PX))
    return np.asarray(np.kron(cells, square)[:shape[0], :shape[1]], np.float64)


def patches(height: int, width: int) -> int:
    """Number of evaluations for a map of a frame, excluding that of the uncovered frame."""
    span = PATCH_PX // STRIDE_PX
    return math.prod(-(-side // STRIDE_PX) + span - 1 for side in (height, width))
