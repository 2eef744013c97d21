"""A small decision tree that tells failures from the rest, as rules in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.model_selection import StratifiedKFold, cross_val_score
from sklearn.tree import DecisionTreeClassifier

from taxinet_ros.analysis.campaign_runs import CampaignRuns
from taxinet_ros.analysis.cause_limits import sayable
from taxinet_ros.analysis.failure_region import Interval, Kinds, Part, Region
from taxinet_ros.analysis.group_rates import GroupRate
from taxinet_ros.analysis.run_features import BY_NAME, PLAIN, kinds_present, ordered_values, varied

LEAST_RUNS, LEAST_OF_A_KIND = 40, 10
_FOLDS, _DEEPEST = 5, 4


@dataclass(frozen=True, kw_only=True, slots=True)
class Rule:
    """A leaf of the tree.

    Attributes:
        region: the scenes in it.
        rate: how often its runs fail, of those that the tree was grown from.
    """

    region: Region
    rate: GroupRate


@dataclass(frozen=True, kw_only=True, slots=True)
class CauseTree:
    """The tree.

    Attributes:
        rules: its leaves, those with the highest rate first.
        depth: questions to the deepest leaf, chosen by cross-validation.
        accuracy: share of held-back runs that it gets right, the mean of five folds.
        guess: share that the commoner outcome would get right.
    """

    rules: tuple[Rule, ...]
    depth: int
    accuracy: float
    guess: float


def grow_tree(runs: CampaignRuns) -> CauseTree | None:
    """Grow the tree; None where there are too few runs or failures, or nothing to split by.

    The depth is the smallest whose log loss on held-back runs is within one standard error of the
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
        Rule(region=sayable(region, runs.frame), rate=runs.rate(region.mask(runs.frame)))
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
    """Numbers as they are, kinds of clouds by their rank."""
    columns = {feature.name: ordered_values(feature, frame) for feature in varied(frame, PLAIN)}
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


def _with(region: Region, name: str, limit: float, above: bool, frame: pd.DataFrame) -> Region:
    """The part of a region on one side of a question."""
    feature = BY_NAME[name]
    old = next((part for part in region.parts if part.feature == name), None)
    others = tuple(part for part in region.parts if part.feature != name)
    new: Part
    if not feature.numeric:
        kinds = old.kinds if isinstance(old, Kinds) else kinds_present(feature, frame)
        new = Kinds(feature=name, kinds=tuple(
            kind for kind in kinds if (feature.kinds.index(kind) > limit) is above))
    else:
        # The ends of an interval are values of runs: no run lies between one and the limit.
        values = frame[name].to_numpy(dtype=np.float64)
        low, high = (old.low, old.high) if isinstance(old, Interval) else (None, None)
        if above:
            low = float(values[values > limit].min())
        else:
            high = float(values[values <= limit].max())
        new = Interval(feature=name, low=low, high=high)
    return Region(parts=(*others, new))
