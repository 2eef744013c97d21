"""Dispersion: how far from all runs a scene can be, and where.

The dispersion of points in a box, each side of which is 1 long, is the greatest distance of any
place from the nearest point (Niederreiter, Random Number Generation and Quasi-Monte Carlo Methods,
SIAM 1992, chapter 6), here in the maximum norm: the largest cube without a point inside it has
sides of twice the dispersion. A small one says that no part of the box was left out, whatever cells
it is cut into.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_PROBES = 1 << 12
_STARTS, _ROUNDS, _MOVES = 32, 40, 16
_ALL_CORNERS = 8
"""Up to so many dimensions all corners of the box are probes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Hole:
    """The largest hole that was found between points.

    Attributes:
        radius: maximum-norm distance of its centre from the nearest point, in shares of each side
            of the box. The dispersion is at least this; it is found by trial, so it may be more.
        centre: (d,) its centre, 0..1.
        least: the least dispersion that any set of so many points can have, as cubes of this size
            have to cover the box.
    """

    radius: float
    centre: Floats
    least: float


def largest_hole(
    points: Floats, inside: Callable[[Floats], npt.NDArray[np.bool_]] | None = None
) -> Hole:
    """The largest hole between points.

    Sobol points and the corners of the box are tried, and the best of them moved uphill; the same
    points give the same result.

    Args:
        points: (n, d) the points, 0..1; one or more.
        inside: which of (m, d) places belong to the box; None: all. The centre of the hole does.

    Raises:
        ValueError: no place belongs to the box.
    """
    from scipy.spatial import cKDTree
    from scipy.stats import qmc

    count, width = points.shape
    tree = cKDTree(points)
    probes: Floats = qmc.Sobol(width, scramble=False).random(_PROBES)
    if width <= _ALL_CORNERS:
        probes = np.vstack([probes, list(itertools.product((0.0, 1.0), repeat=width))])
    kept = probes if inside is None else probes[inside(probes)]
    if not len(kept):
        raise ValueError('no place belongs to the box')
    share = len(kept) / len(probes)
    chance = np.random.default_rng(0)

    def radii(places: Floats) -> Floats:
        found: Floats = tree.query(places, p=np.inf)[0]
        return found

    far = radii(kept)
    best = np.argsort(-far, kind='stable')[:_STARTS]
    centres, radius = kept[best], far[best]
    step = 0.5 * float(radius[0])
    for _ in range(_ROUNDS):
        moved = centres[:, None, :] + chance.normal(0.0, step, (len(centres), _MOVES, width))
        tried = np.clip(moved, 0.0, 1.0).reshape(-1, width)
        found = radii(tried)
        if inside is not None:
            found = np.where(inside(tried), found, -1.0)
        found = found.reshape(len(centres), _MOVES)
        pick = np.argmax(found, axis=1)
        rows = np.arange(len(centres))
        better = found[rows, pick] > radius
        centres[better] = tried.reshape(len(centres), _MOVES, width)[rows, pick][better]
        radius = np.maximum(radius, found[rows, pick])
        step *= 0.85
    top = int(np.argmax(radius))
    return Hole(
        radius=float(radius[top]), centre=centres[top],
        least=0.5 * (share / count) ** (1 / width),
    )
