"""Along which directions failures are spread: principal axes of their standardised features."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.decomposition import PCA

from taxinet_ros.analysis.run_features import CLOUDS_KIND, PLAIN, ordered_values

LEAST_FAILURES = 10
CLOUD_RANK = 'cloud_rank'
"""The kind of clouds as a number, from 0 for a clear sky to 5 for stratus."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PrincipalAxis:
    """A direction.

    Attributes:
        explained: share of the failures' variance along it.
        loadings: part of each standardised feature, by column.
    """

    explained: float
    loadings: Mapping[str, float]


def principal_axes(frame: pd.DataFrame) -> tuple[PrincipalAxis, ...]:
    """Principal axes of the failures, the longest first; none where there are too few.

    Each feature is divided by its standard deviation over all runs, so a feature in which failures
    are as spread as scenes are has variance 1, and one that failures agree in has little.

    Args:
        frame: all runs, with features and ``failed``.
    """
    values = pd.DataFrame({
        feature.name: frame[feature.name] for feature in PLAIN if feature.numeric
    })
    values[CLOUD_RANK] = ordered_values(CLOUDS_KIND, frame)
    values = values.loc[:, values.std(ddof=0) > 0]
    failures = (values / values.std(ddof=0))[frame['failed'].to_numpy(dtype=bool)]
    spread = failures.loc[:, failures.std(ddof=0) > 0]
    if len(spread) < LEAST_FAILURES or spread.shape[1] < 2:
        return ()
    found = PCA(svd_solver='full').fit(spread.to_numpy())
    return tuple(
        PrincipalAxis(explained=float(share), loadings=_signed(list(spread.columns), axis))
        for share, axis in zip(found.explained_variance_ratio_, found.components_, strict=True)
    )


def _signed(names: list[str], axis: np.ndarray) -> dict[str, float]:
    """Loadings with the sign that makes the largest one positive."""
    sign = 1.0 if axis[np.abs(axis).argmax()] > 0 else -1.0
    return {name: float(sign * value) for name, value in zip(names, axis, strict=True)}
