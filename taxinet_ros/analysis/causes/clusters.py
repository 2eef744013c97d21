"""Groups of similar failures."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.cluster import AgglomerativeClustering
from sklearn.metrics import silhouette_score

from taxinet_ros.analysis.causes.region import Interval, Ints, Kinds, Part, Region
from taxinet_ros.analysis.runs.features import (
    BY_NAME,
    CLOUDS_KIND,
    PAPER_FEATURES,
    Feature,
    Floats,
    kinds_present,
    ordered_values,
    varied,
)

LEAST_FAILURES = 12
CLEAR = 0.5
"""Silhouette of clearly separated groups (Kaufman and Rousseeuw, Finding Groups, 1990)."""
_MOST_FAILURES = 1500
_MOST_CLUSTERS = 8
_LEAST_SHARE, _TWO = 0.02, 2
_MIDDLE = (0.05, 0.95)
_PURE, _FEW, _BEYOND = 0.9, 0.7, 0.03


@dataclass(frozen=True, kw_only=True, slots=True)
class Cluster:
    """A group of similar failures.

    Attributes:
        number: from 1, the largest cluster first.
        failures: number of failures in it.
        share: their share of all compared failures.
        typical: run whose mean distance to the others is the least (the medoid).
        common: conditions that nine in ten of its runs satisfy but many other failures do not.
        median_rho: median robustness of its runs.
        runs: ids of its runs.
    """

    number: int
    failures: int
    share: float
    typical: str
    common: Region
    median_rho: float
    runs: tuple[str, ...]

    def words(self) -> str:
        """Display text of the cluster."""
        return self.common.words() or 'all over the scenes'


@dataclass(frozen=True, kw_only=True, slots=True)
class Clusters:
    """Result of clustering the failures.

    Attributes:
        found: clusters, the largest first; empty if there are too few failures.
        silhouette: how well they are separated, from 0 (not at all) to 1 (Rousseeuw 1987).
        compared: number of compared failures, a random sample if there are too many.
        failures: number of all failures.
        why_not: reason why there is no cluster, or ''.
    """

    found: tuple[Cluster, ...]
    silhouette: float
    compared: int
    failures: int
    why_not: str = ''


def find_clusters(frame: pd.DataFrame, telling: Collection[str] = ()) -> Clusters:
    """Group the failures of a campaign.

    The distance is Gower's (Biometrics 27, 1971), a mean over features: for numbers, and for kinds
    of clouds by their rank, the difference over the range of all runs; for other words 0 or 1.
    Clustering is by average linkage. The number of groups maximises the silhouette, but more than
    two are preferred if they are clear enough.

    Args:
        frame: all runs, with features and ``failed``.
        telling: names of the informative features to compare by; all features if none of these
            varies.
    """
    failures = frame[frame['failed']]
    features = varied(frame, PAPER_FEATURES)
    features = tuple(one for one in features if one.name in telling) or features
    if len(failures) < LEAST_FAILURES or not features:
        why = f'{len(failures)} failures: too few to group' if features else 'all scenes are equal'
        return Clusters(found=(), silhouette=0.0, compared=0, failures=len(failures),
                        why_not=why)
    number_of_all = len(failures)
    if number_of_all > _MOST_FAILURES:
        chosen = np.random.default_rng(0).choice(number_of_all, _MOST_FAILURES, replace=False)
        failures = failures.iloc[np.sort(chosen)]
    distances = gower(failures, features, frame)
    silhouette, labels = _best_labels(distances)
    found = tuple(
        _cluster(place, failures, np.flatnonzero(labels == label), distances, frame, features)
        for place, label in enumerate(_of_some_size(labels), 1)
    )
    return Clusters(
        found=found, silhouette=silhouette, compared=len(failures), failures=number_of_all,
    )


def gower(
    some: pd.DataFrame, features: tuple[Feature, ...], frame: pd.DataFrame
) -> Floats:
    """Pairwise distances of ``some`` runs, 0..1, with the ranges of ``frame``."""
    total = np.zeros((len(some), len(some)))
    for feature in features:
        if feature.numeric or feature is CLOUDS_KIND:
            values = ordered_values(feature, some)
            total += np.abs(values[:, None] - values) / np.ptp(ordered_values(feature, frame))
        else:
            column = some[feature.name].to_numpy()
            total += column[:, None] != column
    distance: Floats = total / len(features)
    return distance


def _best_labels(distances: Floats) -> tuple[float, Ints]:
    """Silhouette and labels of the best number of groups.

    Two groups nearly always have the best silhouette but the least information. So unless they are
    clearly separated, they are chosen only if more groups of some size are less than half as clear.
    """
    tried: list[tuple[float, Ints]] = []
    for number in range(2, min(_MOST_CLUSTERS, len(distances) - 1) + 1):
        joined = AgglomerativeClustering(
            n_clusters=number, metric='precomputed', linkage='average'
        ).fit_predict(distances)
        score = float(silhouette_score(distances, joined, metric='precomputed'))
        tried.append((score, joined.astype(np.int64)))
    two, *others = tried
    if two[0] >= CLEAR:
        return max(tried, key=lambda one: round(one[0], 9))
    more = [one for one in others if len(_of_some_size(one[1])) > _TWO]
    best = max(more, key=lambda one: round(one[0], 9), default=two)
    return best if best[0] > two[0] / 2 else two


def _of_some_size(labels: Ints) -> list[int]:
    """Labels of the groups that are more than outliers, the largest first."""
    sizes = np.bincount(labels)
    least = max(2, _LEAST_SHARE * len(labels))
    return [int(one) for one in np.argsort(-sizes, kind='stable') if sizes[one] >= least]


def _cluster(
    number: int, failures: pd.DataFrame, members: Ints, distances: Floats, frame: pd.DataFrame,
    features: tuple[Feature, ...],
) -> Cluster:
    runs = failures.iloc[members]
    medoid = int(distances[np.ix_(members, members)].sum(axis=1).argmin())
    parts = [part for feature in features if (part := _common(feature, runs, frame)) is not None]
    return Cluster(
        number=number, failures=len(runs), share=len(runs) / len(failures),
        typical=str(runs['run_id'].iloc[medoid]), common=Region(parts=tuple(parts)),
        median_rho=float(runs['rho'].median()), runs=tuple(runs['run_id'].astype(str)),
    )


def _common(feature: Feature, runs: pd.DataFrame, frame: pd.DataFrame) -> Part | None:
    """Condition on a feature that nine in ten of the runs satisfy but many others do not."""
    part: Part
    if not feature.numeric:
        counts = runs[feature.name].value_counts(normalize=True)
        kinds = set(counts.index[counts.cumsum().shift(fill_value=0.0) < _PURE])
        ordered = tuple(kind for kind in kinds_present(feature, frame) if kind in kinds)
        part = Kinds(feature=feature.name, kinds=ordered)
    else:
        values, everywhere = runs[feature.name], frame[feature.name]
        low, high = BY_NAME[feature.name].rounded(
            *(float(values.quantile(share)) for share in _MIDDLE))
        # An end with hardly any run beyond it is dropped.
        part = Interval(
            feature=feature.name, low=low if (everywhere < low).mean() > _BEYOND else None,
            high=high if (everywhere > high).mean() > _BEYOND else None,
        )
    return part if part.mask(frame).mean() <= _FEW else None
