"""How well each feature by itself predicts failure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.sparse import csr_array

from taxinet_ros.analysis.causes.region import Ints, interval_cells
from taxinet_ros.analysis.runs.campaign import holm
from taxinet_ros.analysis.runs.features import (
    Feature,
    Floats,
    Mask,
    varied,
)

_SHUFFLES = 999
_CELLS, _RUNS_PER_CELL = 10, 10


@dataclass(frozen=True, kw_only=True, slots=True)
class RankedFeature:
    """How well a feature predicts failure.

    Attributes:
        feature: the feature.
        information_bit: mutual information of the feature, cut into cells, and the outcome, minus
            its mean over shuffled outcomes; a fair coin has 1 bit.
        explained: the same as a share of the deviance, 0..1.
        p: p value by permutation, with Holm's correction (Scandinavian Journal of Statistics 6,
            1979) over all features.
    """

    feature: Feature
    information_bit: float
    explained: float
    p: float


def rank_features(frame: pd.DataFrame) -> tuple[RankedFeature, ...]:
    """Rank the features that vary, the most informative first; none if all outcomes are equal.

    Args:
        frame: runs with features and ``failed``.
    """
    failed = frame['failed'].to_numpy(dtype=bool)
    entropy = float(_entropy(np.array([failed.mean()]))[0])
    features = varied(frame)
    if not features or entropy == 0:
        return ()
    rng = np.random.default_rng(0)
    rows = np.concatenate([failed[None, :],
                           rng.permuted(np.tile(failed, (_SHUFFLES, 1)), axis=1)])
    found = [_information(_cells(feature, frame), rows, entropy) for feature in features]
    p = holm([(1 + int((one[1:] >= one[0] - 1e-12).sum())) / (1 + _SHUFFLES) for one in found])
    ranked = [
        RankedFeature(
            feature=feature, information_bit=max(0.0, float(one[0] - one[1:].mean())),
            explained=max(0.0, float(one[0] - one[1:].mean())) / entropy, p=each,
        )
        for feature, one, each in zip(features, found, p, strict=True)
    ]
    return tuple(sorted(ranked, key=lambda one: -one.information_bit))


def _cells(feature: Feature, frame: pd.DataFrame) -> Ints:
    if not feature.numeric:
        return pd.factorize(frame[feature.name])[0].astype(np.int64)
    values = frame[feature.name].to_numpy(dtype=np.float64)
    most = int(np.clip(len(values) // _RUNS_PER_CELL, 2, _CELLS))
    return interval_cells(values, most)[2]


def _information(cells: Ints, rows: Mask, entropy: float) -> Floats:
    """Mutual information of the cells and each row of outcomes [bit]."""
    counts = np.bincount(cells)
    where = csr_array(
        (np.ones(len(cells), dtype=np.float32), (cells, np.arange(len(cells)))),
        shape=(len(counts), len(cells)),
    )
    share = (where @ rows.T.astype(np.float32)) / counts[:, None]
    left: Floats = (_entropy(share.astype(np.float64)) * counts[:, None]).sum(axis=0)
    return entropy - left / len(cells)


def _entropy(share: Floats) -> Floats:
    """Entropy of a coin with this share of heads [bit]."""
    heads, tails = np.clip(share, 1e-300, 1), np.clip(1 - share, 1e-300, 1)
    return -(share * np.log2(heads) + (1 - share) * np.log2(tails))
