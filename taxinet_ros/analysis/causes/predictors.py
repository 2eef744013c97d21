"""Prediction of failure from features: each by itself, and together in a small decision tree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse import csr_array
from sklearn.model_selection import StratifiedKFold, cross_val_score
from sklearn.tree import DecisionTreeClassifier

from taxinet_ros.analysis.causes.region import Interval, Ints, Kinds, Part, Region, interval_cells
from taxinet_ros.analysis.runs.campaign import CampaignRuns, GroupRate, holm
from taxinet_ros.analysis.runs.features import (
    BY_NAME,
    PAPER_FEATURES,
    PUSHING_FEATURES,
    Feature,
    Floats,
    Mask,
    kinds_present,
    ordered_values,
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


LEAST_RUNS, LEAST_OF_A_KIND = 40, 10
_FOLDS, _DEEPEST = 5, 4


@dataclass(frozen=True, kw_only=True, slots=True)
class Rule:
    """A leaf of the tree.

    Attributes:
        region: its scenes.
        rate: failure rate of its runs among those that the tree was grown from.
    """

    region: Region
    rate: GroupRate


@dataclass(frozen=True, kw_only=True, slots=True)
class CauseTree:
    """A decision tree that predicts failure.

    Attributes:
        rules: its leaves, the highest rate first.
        depth: depth of the deepest leaf, chosen by cross-validation.
        accuracy: share of held-out runs that it predicts correctly, mean of five folds.
        guess: share that the more frequent outcome would predict correctly.
    """

    rules: tuple[Rule, ...]
    depth: int
    accuracy: float
    guess: float


def grow_tree(runs: CampaignRuns) -> CauseTree | None:
    """Grow the tree; None if there are too few runs or failures, or nothing to split by.

    The depth is the smallest whose log loss on held-out runs is within one standard error of the
    best (Breiman, Friedman, Olshen and Stone, Classification and Regression Trees, 1984).
    """
    failed = runs.failed
    columns = _columns(runs.frame)
    of_a_kind = min(int(failed.sum()), int((~failed).sum()))
    if len(failed) < LEAST_RUNS or of_a_kind < LEAST_OF_A_KIND or columns.empty:
        return None
    folds = StratifiedKFold(_FOLDS, shuffle=True, random_state=0)
    values = columns.to_numpy()
    losses = np.array([
        cross_val_score(_tree(depth, len(failed)), values, failed, cv=folds, scoring='neg_log_loss')
        for depth in range(1, _DEEPEST + 1)
    ])
    mean = losses.mean(axis=1)
    best = int(mean.argmax())
    error = float(losses[best].std(ddof=1)) / np.sqrt(_FOLDS)
    depth = int(np.flatnonzero(mean >= mean[best] - error)[0]) + 1
    right = cross_val_score(_tree(depth, len(failed)), values, failed, cv=folds)
    tree = _tree(depth, len(failed)).fit(values, failed)
    rules = [
        Rule(region=_in_order(region), rate=runs.rate(region.mask(runs.frame)))
        for region in _leaves(tree.tree_, list(columns.columns), runs.frame)
    ]
    return CauseTree(
        rules=tuple(sorted(rules, key=lambda rule: -rule.rate.rate)), depth=depth,
        accuracy=float(right.mean()), guess=float(max(failed.mean(), 1 - failed.mean())),
    )


def _tree(depth: int, runs: int) -> DecisionTreeClassifier:
    return DecisionTreeClassifier(
        max_depth=depth, min_samples_leaf=max(8, runs // 100), criterion='entropy', random_state=0,
    )


def _columns(frame: pd.DataFrame) -> pd.DataFrame:
    """Feature columns: numbers unchanged, kinds of clouds by their rank."""
    columns = {
        feature.name: ordered_values(feature, frame)
        for feature in varied(frame, (*PAPER_FEATURES, *PUSHING_FEATURES))
    }
    return pd.DataFrame(columns, index=frame.index)


def _leaves(tree: Any, names: list[str], frame: pd.DataFrame) -> Iterator[Region]:
    """The region of each leaf, from left to right."""
    def below(node: int, region: Region) -> Iterator[Region]:
        if tree.children_left[node] < 0:
            yield region
            return
        name, limit = names[tree.feature[node]], float(tree.threshold[node])
        yield from below(tree.children_left[node], _with(region, name, limit, False, frame))
        yield from below(tree.children_right[node], _with(region, name, limit, True, frame))

    yield from below(0, Region(parts=()))


def _in_order(region: Region) -> Region:
    order = list(BY_NAME)
    return Region(parts=tuple(sorted(region.parts, key=lambda part: order.index(part.feature))))


def rounded_ends(feature: Feature, below: float, above: float) -> tuple[float, float]:
    """Round ends of the two sides of a split, which do not overlap.

    Args:
        feature: feature that is split by.
        below: greatest value of a run on the lower side.
        above: least value of a run on the upper side.
    """
    most, least = feature.rounded(below, below)[1], feature.rounded(above, above)[0]
    if most <= least:
        return most, least
    middle = (below + above) / 2
    return middle, middle  # both sides name it; no run lies there


def _with(region: Region, name: str, limit: float, above: bool, frame: pd.DataFrame) -> Region:
    """The part of a region on one side of a split."""
    feature = BY_NAME[name]
    old = next((part for part in region.parts if part.feature == name), None)
    others = tuple(part for part in region.parts if part.feature != name)
    new: Part
    if not feature.numeric:
        kinds = old.kinds if isinstance(old, Kinds) else kinds_present(feature, frame)
        new = Kinds(feature=name, kinds=tuple(
            kind for kind in kinds if (feature.kinds.index(kind) > limit) is above))
    else:
        values = frame[name].to_numpy(dtype=np.float64)
        most, least = rounded_ends(
            feature, float(values[values <= limit].max()), float(values[values > limit].min()))
        low, high = (old.low, old.high) if isinstance(old, Interval) else (None, None)
        low, high = (least, high) if above else (low, most)
        new = Interval(feature=name, low=low, high=high)
    return Region(parts=(*others, new))
