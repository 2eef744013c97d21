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
BEYOND = f'it seems to be more than the {_LATEST_S:g} s that is tried, as of clocks that differ'
_WIDEST_S = 0.3
_LATENCY_BLOCKS, _LATENCY_RESAMPLES = 10, 400
_SMOOTH_S = 0.5
_LEAST_GAIN = 10.0
"""Least difference of twice the log-likelihood between the best latency and the worst one."""
_TURNING = 0.2, math.radians(1.0)
"""Standard deviations of cross-track [m] and heading error [rad] of a path that turns or drifts."""
_UNSEEN_SHARE = 0.9
"""Estimates of which the truth leaves so much of the standard deviation do not follow it."""


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

    For each latency the estimates are fitted by the truth so much earlier: each is linear in both
    cross-track and heading error, as a network may have offsets and scales wrong, and one whose
    cross-track errs with the heading would else look early or late. The likelihood of what remains
    is compared. The interval is from resampled blocks of frames.

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
        sampled = replace(truth, poses=poses._replace(
            y_m=errors[:, 0], yaw_rad=unwrapped(errors[:, 1])))
        rows = np.array([
            sampled.at(stamps_ns - round(shift * NS_PER_S))[1:3] for shift in shifts
        ]).transpose(0, 2, 1)
        known = np.isfinite(rows).all(axis=(0, 2)) & np.isfinite(seen).all(axis=1)
        # Between two samples interpolation averages their noise, which would favour those shifts.
        # Estimates alike, as the means of a turn are not its middle.
        apart_ns = np.median(np.diff(stamps_ns)) if len(stamps_ns) > 1 else NS_PER_S
        half = round(_SMOOTH_S * NS_PER_S / max(apart_ns, 1e6))
        shifted.append(_smoothed(rows[:, known], half))
        estimates.append(_smoothed(seen[known], half))
        groups.append(np.full(len(estimates[-1]), number))
    return _best_shift(
        shifts, np.concatenate(shifted, axis=1), np.concatenate(estimates), np.concatenate(groups))


def _smoothed(values: Floats, half: int) -> Floats:
    """Means with so many frames on either side, along the last axis but one; of those inside."""
    half = min(half, max(values.shape[-2] - 1, 0) // 2)
    if not half:
        return values
    return np.lib.stride_tricks.sliding_window_view(values, 2 * half + 1, axis=-2).mean(axis=-1)


def _best_shift(
    shifts: Floats, shifted: Floats, estimates: Floats, groups: NDArray[np.int64]
) -> Latency:
    count = len(estimates)
    unknown = Latency(math.nan, math.nan, math.nan)
    if count < 50:
        return unknown._replace(why=f'{count} frames between samples of the truth, too few')
    one = np.zeros(count, np.int64)
    whole = _likelihood(_moments(shifted, estimates, one)[:, 0])
    best = _peak(shifts, whole)
    place = (best - shifts[0]) / _STEP_S
    before = min(int(place), len(shifts) - 2)
    here = shifted[before] + (place - before) * (shifted[before + 1] - shifted[before])
    basis = np.column_stack([np.ones(count), here])
    left = estimates - basis @ np.linalg.lstsq(basis, estimates, rcond=None)[0]
    blocks, alike = blocks_of(left.T, groups, _LATENCY_BLOCKS)
    number = int(blocks.max()) + 1
    # Correlated frames count as fewer.
    if (whole.max() - whole.min()) / alike < _LEAST_GAIN:
        moves = bool((here.std(axis=0) > _TURNING).any())
        unseen = bool((left.std(axis=0) > _UNSEEN_SHARE * estimates.std(axis=0)).all())
        return unknown._replace(why='the aircraft hardly turns or drifts' if not moves else (
            'the estimates hardly follow the path' if unseen else
            'the path is so even that any fits'))
    terms = _moments(shifted, estimates, blocks)
    drawn = np.random.default_rng(0).multinomial(
        number, np.full(number, 1 / number), _LATENCY_RESAMPLES).astype(np.float64)
    found = [
        _peak(shifts, _likelihood(np.tensordot(terms, weights, (1, 0)))) for weights in drawn
    ]
    low, high = np.percentile(found, [2.5, 97.5])
    if high - low > _WIDEST_S:
        return unknown._replace(why=(
            f'on a path so short or even, any from {low:+.2f} to {high:+.2f} s fits about as well; '
            'a longer one with uneven turns would tell'))
    if abs(best) >= _LATEST_S - _STEP_S:
        return unknown._replace(why=BEYOND)
    return Latency(best, float(low), float(high))


def _moments(shifted: Floats, estimates: Floats, blocks: NDArray[np.int64]) -> Floats:
    """Sums of products of 1, both truths and both estimates, (shifts, blocks, 5, 5)."""
    starts = np.flatnonzero(np.diff(blocks, prepend=-1))
    rows = []
    for truth in shifted:
        values = np.column_stack([
            np.ones(len(truth)), truth - truth.mean(axis=0), estimates - estimates.mean(axis=0)])
        rows.append(np.add.reduceat(values[:, :, None] * values[:, None, :], starts))
    return np.array(rows)


def _likelihood(moments: Floats) -> Floats:
    """Twice the log-likelihood (shifts,) of estimates that are linear in both truths."""
    count = moments[:, 0, 0]
    known = moments[:, :3, :3] + 1e-9 * count[:, None, None] * np.eye(3)
    joint = moments[:, :3, 3:]
    left = moments[:, 3:, 3:] - joint.transpose(0, 2, 1) @ np.linalg.solve(known, joint)
    spread = np.diagonal(left, axis1=1, axis2=2) / count[:, None]
    found: Floats = -count * np.log(np.maximum(spread, 1e-12)).sum(axis=1)
    return found


def _peak(shifts: Floats, curve: Floats) -> float:
    """The place of the maximum, by a parabola through it and its neighbours."""
    at = int(curve.argmax())
    if not 0 < at < len(curve) - 1:
        return float(shifts[at])
    before, here, after = curve[at - 1:at + 2]
    bend = before - 2 * here + after
    return float(shifts[at] + (_STEP_S * (before - after) / (2 * bend) if bend < 0 else 0.0))
