"""On which part of a picture an estimate depends: cover a patch, and see how it changes.

Occlusion sensitivity (Zeiler and Fergus, Visualizing and understanding convolutional networks,
ECCV 2014, section 4.2) asks nothing of the network but its answers. In place of their grey square
a patch shows the blurred picture, with soft edges: the light of the place stays, what stands out
in it goes, and no edge comes in that was not there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.analysis.explain.track import Estimator, Floats, Frame
from taxinet_ros.core.controller import SteeringGains

PATCH_PX = 30
"""Side of a patch: as wide as the centreline looks from 7 m."""

STRIDE_PX = 10
"""From one patch to the next: 836 looks for a map, about a second with a network of ours."""

_SOFT_PX = 6
_ROWS = ('upper', '', 'lower')
_COLUMNS = ('left', 'middle', 'right')


@dataclass(frozen=True, kw_only=True, eq=False)
class OcclusionMap:
    """How the estimate changes where the picture is covered.

    Attributes:
        cte_m: change of the estimated cross-track error by cells of :data:`STRIDE_PX`, the mean
            over the patches that cover a cell [m].
        he_rad: the same of the heading error [rad].
        weight_rad: how much of the heading that the steering law asks for hangs on a cell [rad].
        lost: patches that, covered, leave the network without an answer.
    """

    cte_m: Floats
    he_rad: Floats
    weight_rad: Floats
    lost: int

    @property
    def region(self) -> tuple[str, float]:
        """The ninth of the picture that matters most, in words, and its share of the effect.

        The share is 0 where nothing matters at all.
        """
        parts = {
            (row, column): float(cell.sum())
            for row, band in enumerate(np.array_split(self.weight_rad, 3, axis=0))
            for column, cell in enumerate(np.array_split(band, 3, axis=1))
        }
        row, column = max(parts, key=lambda place: parts[place])
        total = sum(parts.values())
        words = f'{_ROWS[row]} {_COLUMNS[column]}'.strip()
        return ('centre' if words == 'middle' else words,
                parts[row, column] / total if total > 0 else 0.0)

    def share(self, mask: NDArray[np.bool_]) -> float:
        """The share of the effect that lies where ``mask`` (H, W) of the picture is set."""
        weight = _in_pixels(self.weight_rad, mask.shape)
        total = float(weight.sum())
        return float(weight[mask].sum()) / total if total > 0 else 0.0


def occlusion_map(look: Estimator, image: Frame, gains: SteeringGains) -> OcclusionMap:
    """Cover a frame patch by patch, and let the network look at each.

    Args:
        look: the network; equal frames have to give equal answers.
        image: camera frame, (H, W, 3) uint8 RGB.
        gains: of the steering law that the estimate goes to; they weigh metres against radians.
    """
    whole = look(image)
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
        sums[part] += (cte_m, he_rad, abs(he_rad + gains.cte_gain_rad_per_m * cte_m))
        counts[part] += 1
    mean = sums / np.maximum(counts, 1)[:, :, np.newaxis]
    return OcclusionMap(
        cte_m=mean[:, :, 0], he_rad=mean[:, :, 1], weight_rad=mean[:, :, 2], lost=lost)


def changed_pixels(one: Frame, other: Frame, levels: int = 4) -> NDArray[np.bool_]:
    """Where two frames differ by more than ``levels`` in some colour, (H, W)."""
    return np.asarray(cv2.absdiff(one, other).max(axis=2) > levels, np.bool_)


def _cover(
    image: Frame, covered: Frame, soft: NDArray[np.float32], top: int, left: int
) -> Frame:
    """The frame with a patch at (top, left), which may hang over its borders."""
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
    """How much a patch covers, 0..1, (PATCH_PX, PATCH_PX, 1): all in its middle, less at edges."""
    place = np.arange(PATCH_PX)
    ramp = np.minimum((np.minimum(place, place[::-1]) + 1) / _SOFT_PX, 1.0)
    return np.outer(ramp, ramp).astype(np.float32)[:, :, np.newaxis]


def _in_pixels(cells: Floats, shape: tuple[int, ...]) -> Floats:
    square = np.ones((STRIDE_PX, STRIDE_PX))
    return np.asarray(np.kron(cells, square)[:shape[0], :shape[1]], np.float64)


def patches(height: int, width: int) -> int:
    """How many looks a map of a frame takes, the one at the whole frame not counted."""
    span = PATCH_PX // STRIDE_PX
    return math.prod(-(-side // STRIDE_PX) + span - 1 for side in (height, width))
