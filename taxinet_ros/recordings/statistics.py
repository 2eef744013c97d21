"""Statistics of frames in a row, which are not independent: block bootstrap and latency.

Blocks of consecutive frames are resampled (Künsch, The Annals of Statistics 17, 1989, here without
overlap), five times as long as the errors' integrated autocorrelation time. With few blocks the
percentile interval is too narrow; it is widened as Hesterberg proposes (The American Statistician
69, 2015, section 4.1) by Student's t of the number of blocks less one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from taxinet_ros.core.place.track import Track
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.recordings.truth import Truth, unwrapped

Floats = NDArray[np.float64]
RESAMPLES = 2000
LEAST_BLOCKS = 5
"""Fewer blocks than these give no interval."""
_BLOCKS_PER_TIME = 5
_MOST_LAG = 200
_MOST_BLOCKS = 400
_LATEST_S, _STEP_S = 1.0, 0.02
_WIDEST_S = 0.3
_LATENCY_BLOCKS = 10
_LEAST_GAIN = 10.0
"""Least difference of twice the log-likelihood between the best latency and the worst one."""


class Mean(NamedTuple):
    """A mean with its 95 % interval, NaN where there are too few blocks.

    Attributes:
        value: the mean; NaN without frames.
        low, high: interval.
        frames: number of frames.
        blocks: number of blocks with such frames.
    """

    value: float
    low: float
    high: float
    frames: int
    blocks: int


def correlation_frames(errors: Floats, groups: NDArray[np.int64]) -> float:
    """Number of frames that tell as much as one independent one, at least 1.

    The sum of autocorrelations ends at the first that is not positive.

    Args:
        errors: (n,) in the order of time; NaN is left out.
        groups: (n,) number of the uninterrupted stretch of each.
    """
    known = np.isfinite(errors)
    if known.sum() < 3:
        return 1.0
    centred = np.where(known, errors - errors[known].mean(), 0.0)
    variance = float((centred**2).sum() / known.sum())
    if variance <= 0:
        return float(known.sum())  # a constant error is one observation
    total = 1.0
    for lag in range(1, min(_MOST_LAG, len(errors) - 1)):
        pairs = (groups[lag:] == groups[:-lag]) & known[lag:] & known[:-lag]
        if not pairs.any():
            break
        products = centred[lag:] * centred[:-lag]
        correlation = float(products[pairs].mean()) / variance
        if correlation <= 0:
            break
        total += 2 * correlation
    return total


def blocks_of(
    columns: NDArray[np.float64], groups: NDArray[np.int64], least: int = 1
) -> tuple[NDArray[np.int64], float]:
    """The block of each frame, numbered from 0, and how many frames count as one.

    Args:
        columns: (k, n) errors of several quantities; the most correlated one counts.
        groups: (n,) number of the uninterrupted stretch of each frame, ascending.
        least: number of blocks, where there would be fewer.
    """
    alike = max((correlation_frames(column, groups) for column in columns), default=1.0)
    size = max(1, min(math.ceil(_BLOCKS_PER_TIME * alike), len(groups) // least))
    size = max(size, math.ceil(len(groups) / _MOST_BLOCKS))  # more take time and change nothing
    blocks = np.zeros(len(groups), np.int64)
    number = 0
    for group in np.unique(groups):
        own = np.flatnonzero(groups == group)
        count = max(1, round(len(own) / size))
        blocks[own] = number + np.arange(len(own)) * count // max(len(own), 1)
        number += count
    return blocks, alike


def block_mean(values: Floats, blocks: NDArray[np.int64], seed: int = 0) -> Mean:
    """Mean of the values that are no NaN, by bootstrap over blocks."""
    known = np.isfinite(values)
    count = int(known.sum())
    if not count:
        return Mean(math.nan, math.nan, math.nan, 0, 0)
    _, own = np.unique(blocks[known], return_inverse=True)
    sums = np.bincount(own, values[known])
    sizes = np.bincount(own).astype(np.float64)
    total, mean = len(sums), float(values[known].mean())
    if total < LEAST_BLOCKS:
        return Mean(mean, math.nan, math.nan, count, total)
    drawn = np.random.default_rng(seed).multinomial(
        total, np.full(total, 1 / total), RESAMPLES).astype(np.float64)
    means = (drawn @ sums) / (drawn @ sizes)
    low, high = np.percentile(means, [2.5, 97.5]) - mean
    wider = math.sqrt(total / (total - 1)) * float(
        stats.t.ppf(0.975, total - 1) / stats.norm.ppf(0.975))
    return Mean(mean, mean + wider * float(low), mean + wider * float(high), count, total)


class Latency(NamedTuple):
    """By how much stamps of pictures are later than what they show [s].

    Attributes:
        value_s: estimate; NaN if the recording does not determine it.
        low_s, high_s: 95 % interval.
        why: why it is unknown, or ''.
    """

    value_s: float
    low_s: float
    high_s: float
    why: str = ''


def estimate_latency(
    parts: Sequence[tuple[Truth, NDArray[np.int64], Floats]], track: Track
) -> Latency:
    """The latency with which a network's estimates agree best with the truth.

    For each latency the estimates are fitted by the truth so much earlier, with an offset and a
    scale, which a network may have wrong; the likelihood of what remains is compared. The interval
    is from resampled blocks of frames.

    Args:
        parts: of each bag truth, stamps (n,) of the frames, and estimates (n, 2): cross-track [m]
            and heading error [rad]; NaN is left out.
        track: that errors are measured from.
    """
    shifts = np.arange(-_LATEST_S, _LATEST_S + _STEP_S / 2, _STEP_S)
    shifted, estimates, groups = [], [], []
    for number, (truth, stamps_ns, seen) in enumerate(parts):
        poses = truth.poses
        errors = np.array([
            track.measure(x, y, yaw)[1:] for x, y, yaw in zip(
                *(column.tolist() for column in poses[:3]), strict=True)
        ])
        # Errors of the samples are interpolated, not of the frames, of which there are 101 shifts.
        sampled = replace(truth, poses=poses._replace(
            y_m=errors[:, 0], yaw_rad=unwrapped(errors[:, 1])))
        rows = np.array([
            sampled.at(stamps_ns - round(shift * NS_PER_S))[1:3] for shift in shifts
        ]).transpose(0, 2, 1)
        known = np.isfinite(rows).all(axis=(0, 2)) & np.isfinite(seen).all(axis=1)
        shifted.append(rows[:, known])
        estimates.append(seen[known])
        groups.append(np.full(int(known.sum()), number))
    return _best_shift(
        shifts, np.concatenate(shifted, axis=1), np.concatenate(estimates), np.concatenate(groups))


def _best_shift(
    shifts: Floats, shifted: Floats, estimates: Floats, groups: NDArray[np.int64]
) -> Latency:
    count = len(estimates)
    unknown = Latency(math.nan, math.nan, math.nan)
    if count < 50:
        return unknown._replace(why=f'{count} frames between samples of the truth, too few')
    whole = _likelihood(_block_sums(shifted, estimates, np.zeros(count, np.int64))[..., 0])
    best = _peak(shifts, whole)
    place = (best - shifts[0]) / _STEP_S
    low = min(int(place), len(shifts) - 2)
    here = shifted[low] + (place - low) * (shifted[low + 1] - shifted[low])
    blocks, alike = blocks_of(_residuals(here, estimates).T, groups, _LATENCY_BLOCKS)
    number = int(blocks.max()) + 1
    # Correlated frames count as fewer.
    if (whole.max() - whole.min()) / alike < _LEAST_GAIN:
        return unknown._replace(why='the aircraft hardly turns or drifts')
    terms = _block_sums(shifted, estimates, blocks)
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(number, np.full(number, 1 / number), 400).astype(np.float64)
    found = [_peak(shifts, _likelihood(terms @ weights)) for weights in drawn]
    low, high = np.percentile(found, [2.5, 97.5])
    if high - low > _WIDEST_S or abs(best) >= _LATEST_S - _STEP_S:
        return unknown._replace(why=f'anything from {low:+.2f} to {high:+.2f} s fits')
    return Latency(best, float(low), float(high))


def _residuals(truth: Floats, estimates: Floats) -> Floats:
    found = np.empty_like(estimates)
    for column in range(2):
        basis = np.stack([np.ones(len(truth)), truth[:, column]], axis=1)
        fitted, *_ = np.linalg.lstsq(basis, estimates[:, column], rcond=None)
        found[:, column] = estimates[:, column] - basis @ fitted
    return found


def _block_sums(shifted: Floats, estimates: Floats, blocks: NDArray[np.int64]) -> Floats:
    """Sums of products (shift, product and quantity, block) that a regression needs."""
    number = int(blocks.max()) + 1
    rows = []
    for truth in shifted:
        products = []
        for column in range(2):
            x, y = truth[:, column] - truth[:, column].mean(), estimates[:, column]
            products += [np.ones(len(x)), x, y, x * x, x * y, y * y]
        rows.append([np.bincount(blocks, one, number) for one in products])
    return np.array(rows)


def _likelihood(sums: Floats) -> Floats:
    """Twice the log-likelihood (shifts,) of regressions with these sums (shifts, 12)."""
    total = np.zeros(len(sums))
    for first in (0, 6):
        n, x, y, xx, xy, yy = sums[:, first:first + 6].T
        varies = xx - x * x / n
        joint = xy - x * y / n
        left = yy - y * y / n - np.where(varies > 1e-12, joint**2 / np.maximum(varies, 1e-12), 0.0)
        total -= n * np.log(np.maximum(left / n, 1e-12))
    return total


def _peak(shifts: Floats, curve: Floats) -> float:
    """The place of the maximum, by a parabola through it and its neighbours."""
    at = int(curve.argmax())
    if not 0 < at < len(curve) - 1:
        return float(shifts[at])
    before, here, after = curve[at - 1:at + 2]
    bend = before - 2 * here + after
    return float(shifts[at] + (_STEP_S * (before - after) / (2 * bend) if bend < 0 else 0.0))
