"""Nearest training images of a frame, and its distance from the data set.

Picture distance: root mean square difference of grey levels in the networks' input
(:func:`taxinet_ros.core.perception.network.shrink`) at a quarter of its size. Scene distance: by
labels and weather, each in units of its spread in the data set.

The reference is the data set itself: the distance of each of its images to the nearest other one.
A frame farther away than nearly all of these is out of distribution.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.neighbors import NearestNeighbors

from taxinet_ros.analysis.explain.track import Floats, Frame
from taxinet_ros.core.perception.network import INPUT_SHAPE, shrink

NEAREST = 3
"""Number of images shown."""

FAR = 0.99
"""Quantile of the data set's own distances beyond which a frame is out of distribution."""

_PART = 4
_NUMBERS = ('cte_m', 'heading_error_deg', 'time_of_day_h', 'rain_percent')
_WORDS = ('clouds',)


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingImages:
    """A data set, or an even sample of one.

    Attributes:
        name: name of its folder.
        total: number of images in the folder; the sample may be smaller.
        pictures: images reduced to a network's input, (N, 64, 192) uint8.
        scenes: one row per image: ``cte_m``, ``heading_error_deg``, if known ``distance_m``,
            ``time_of_day_h``, ``clouds``, ``rain_percent``; and ``image``, its name.
    """

    name: str
    total: int
    pictures: NDArray[np.uint8]
    scenes: pd.DataFrame


@dataclass(frozen=True, kw_only=True)
class Neighbour:
    """A training image near to a frame.

    Attributes:
        row: row in the data set.
        distance: in grey levels (picture), or in spreads (scene).
    """

    row: int
    distance: float


@dataclass(frozen=True, kw_only=True)
class Nearness:
    """Distance of a frame from a data set.

    Attributes:
        by_picture, by_scene: the nearest images, the nearest first.
        farther_than: share of the data set's images whose nearest other image is closer than this
            frame's nearest image, 0..1.
        usual: median of the data set's own nearest distances [grey levels].
    """

    by_picture: tuple[Neighbour, ...]
    by_scene: tuple[Neighbour, ...]
    farther_than: float
    usual: float

    @property
    def foreign(self) -> bool:
        """Whether the frame is out of distribution."""
        return self.farther_than >= FAR


class NearestImages:
    """Search index of a data set."""

    def __init__(self, images: TrainingImages) -> None:
        """Compute the distances within the data set.

        Raises:
            ValueError: it has fewer than two images.
        """
        if len(images.pictures) < 2:
            raise ValueError('one image has no nearest other one')
        self.images = images
        known = _features(images.pictures)
        self._search = NearestNeighbors(n_neighbors=NEAREST, algorithm='brute').fit(known)
        distances, _ = self._search.kneighbors(n_neighbors=1)
        self._own = np.sort(distances[:, 0]) / math.sqrt(known.shape[1])
        self._size = known.shape[1]

    def near(self, image: Frame, scene: Mapping[str, float | str]) -> Nearness:
        """Compare a frame with the data set.

        Args:
            image: camera frame, (200, 360, 3) uint8 RGB.
            scene: known values of the columns of :attr:`TrainingImages.scenes`.
        """
        k = min(NEAREST, len(self._own))
        far, rows = self._search.kneighbors(_features(shrink(image)[np.newaxis]), n_neighbors=k)
        levels = far[0] / math.sqrt(self._size)
        return Nearness(
            by_picture=_neighbours(rows[0].tolist(), levels),
            by_scene=_by_scene(self.images.scenes, scene, k),
            farther_than=float(np.searchsorted(self._own, levels[0])) / len(self._own),
            usual=float(np.median(self._own)),
        )


def _by_scene(
    scenes: pd.DataFrame, scene: Mapping[str, float | str], k: int
) -> tuple[Neighbour, ...]:
    squares: Floats = np.zeros(len(scenes))
    for name in _NUMBERS:
        if name in scenes and name in scene:
            values = scenes[name].to_numpy(dtype=np.float64)
            spread = float(values.std())
            squares += ((values - float(scene[name])) / spread) ** 2 if spread > 0 else 0.0
    for name in _WORDS:
        if name in scenes and name in scene:
            squares += (scenes[name] != scene[name]).to_numpy(dtype=np.float64)
    rows = np.argsort(squares, kind='stable')[:k]
    return _neighbours(rows.tolist(), np.sqrt(squares[rows]))


def _neighbours(rows: Sequence[int], distances: Floats) -> tuple[Neighbour, ...]:
    return tuple(
        Neighbour(row=row, distance=distance)
        for row, distance in zip(rows, distances.tolist(), strict=True)
    )


def _features(pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Mean grey levels of blocks of pictures (N, 64, 192), one row per picture."""
    size = (INPUT_SHAPE[1] // _PART, INPUT_SHAPE[0] // _PART)
    small = [cv2.resize(p, size, interpolation=cv2.INTER_AREA).ravel() for p in pictures]
    return np.array(small, dtype=np.float32)
