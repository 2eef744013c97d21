"""Conformal lower bounds on a quantity that is known only at the end of a run.

Split conformal prediction (Papadopoulos et al. 2002; Lei et al., JASA 113, 2018): half of the runs
train a predictor, the other half measure by how much it is too high. If a new run is exchangeable
with the calibration runs (drawn from the same program, with the same network and all else), its own
excess is equally likely to have any rank among theirs. So it is below the ceil((n + 1) c)-th
smallest of the n with a probability of at least c, whatever the predictor is worth; a poor one only
gives low bounds. The probability is over new runs *and* calibrations: it is no promise for one
scene, nor for the failing runs alone.

Somebody who watches a run looks at more than one moment. So with probability c the bounds at *all*
moments hold: the excess of a run is the largest of all moments, each in units of its usual size
(Cleaveland et al., AAAI 2024; Lindemann et al., IEEE RA-L 2023). If all bounds hold then so does
the greatest so far, so the bounds never fall during a run.

The predictor is a low quantile of the outcomes of the most similar training runs at that moment
(Romano et al., NeurIPS 2019, correct quantiles likewise); the usual size of its excess is the
spread of those outcomes, plus a small share of what is usual at that moment. So bounds are tight
where similar runs ended alike. Outcomes are compressed by arcsinh, so
that the depth of failures does not decide about runs that pass; conformal ranks are the same on any
scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.errors import UsageError

Floats = NDArray[np.float64]

QUANTILE = 0.1
"""Quantile of the outcomes of similar runs that is predicted."""
DIGITS = 6
"""Decimals of stored numbers; scores are of the rounded ones, so a stored model is the same."""
FLOOR = 0.1
"""Share of a moment's usual excess that is added to the spread of similar runs."""
_LOWEST = 1e6
"""A bound below minus this many scales says nothing; it is -inf."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ConformalModel:
    """A trained and calibrated predictor of lower bounds.

    Attributes:
        features: of the training runs, (N, T, F), at T moments.
        outcomes: of the training runs, (N,).
        neighbours: number of similar runs that predict.
        scale: outcomes are compressed beyond this size.
        widths: usual size of the excess at each moment, (T,).
        excesses: of the M calibration runs, (M, T): compressed prediction minus outcome, divided by
            the usual size of both.
    """

    features: Floats
    outcomes: Floats
    neighbours: int
    scale: float
    widths: Floats
    excesses: Floats
    _centre: Floats = field(init=False, repr=False)
    _spread: Floats = field(init=False, repr=False)
    _compressed: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Standardize the training runs."""
        centre, spread = self.features.mean(axis=0), self.features.std(axis=0)
        spread[spread < 1e-9] = 1.0
        object.__setattr__(self, '_centre', centre)
        object.__setattr__(self, '_spread', spread)
        object.__setattr__(self, '_compressed', _compress(self.outcomes, self.scale))

    @property
    def moments(self) -> int:
        """Number of moments."""
        return len(self.widths)

    @property
    def calibration_runs(self) -> int:
        """Number of runs that calibrate it."""
        return len(self.excesses)

    def predictions(
        self, features: Floats, moment: int, *, apart: bool = False
    ) -> tuple[Floats, Floats]:
        """Compressed predictions at a moment, (R,), and the usual size of their excess, (R,).

        ``apart``: the features (R, F) are of the training runs, each to be predicted by the others.
        """
        centre, spread = self._centre[moment], self._spread[moment]
        known = (self.features[:, moment] - centre) / spread
        asked = (features - centre) / spread
        distances = ((asked[:, None, :] - known[None, :, :]) ** 2).sum(axis=-1)
        if apart:
            np.fill_diagonal(distances, np.inf)
        # Stable, so that equally distant runs are chosen by their number on every machine.
        nearest = np.argsort(distances, axis=1, kind='stable')[:, :self.neighbours]
        similar = self._compressed[nearest]
        sizes = similar.std(axis=1) + FLOOR * self.widths[moment]
        return np.asarray(np.quantile(similar, QUANTILE, axis=1), dtype=np.float64), sizes

    def margin(self, confidence: float) -> float:
        """How many usual sizes are taken off the compressed predictions."""
        least = least_calibration_runs(confidence)
        number = self.calibration_runs
        if number < least:
            raise UsageError(
                f'confidence {confidence:g}: needs at least {least} calibration runs, not '
                f'{number}; calibrate on a campaign of {2 * least} or more'
            )
        rank = math.ceil((number + 1) * confidence - 1e-9) - 1
        return float(np.sort(self.excesses.max(axis=1))[rank])

    def bounds(self, features: Floats, moment: int, margin: float) -> Floats:
        """Lower bounds of runs at a moment, (R,); -inf where nothing is known."""
        predicted, sizes = self.predictions(features, moment)
        compressed = predicted - margin * sizes
        lowest = -math.asinh(_LOWEST)
        found = self.scale * np.sinh(np.clip(compressed, lowest, -lowest))
        return np.where(compressed <= lowest, -np.inf, found)


def least_calibration_runs(confidence: float) -> int:
    """Fewest calibration runs for a confidence: 19 for 95 %."""
    if not 0.5 <= confidence < 1:
        raise UsageError(f'confidence {confidence:g}: needs to be within 0.5..1')
    return math.ceil(confidence / (1 - confidence) - 1e-9)


def fit(features: Floats, outcomes: Floats) -> ConformalModel:
    """Train on the runs with even positions and calibrate on the others.

    Args:
        features: of all runs, (R, T, F), in an order that does not depend on their outcomes.
        outcomes: of all runs, (R,).
    """
    if len(outcomes) < 40:
        raise UsageError(f'{len(outcomes)} runs are too few to calibrate on; 40 are the least')
    features, outcomes = features.round(DIGITS), outcomes.round(DIGITS)
    trained, known = features[::2], outcomes[::2]
    sizes = np.abs(known)
    scale = max(float(np.quantile(sizes, 0.25)), 1e-3)
    moments = features.shape[1]
    draft = ConformalModel(
        features=trained, outcomes=known, neighbours=min(max(len(known) // 20, 5), 50),
        scale=round(scale, DIGITS), widths=np.ones(moments), excesses=np.zeros((0, moments)),
    )
    compressed = _compress(known, draft.scale)
    own = np.stack([
        draft.predictions(trained[:, moment], moment, apart=True)[0] - compressed
        for moment in range(moments)
    ], axis=1)
    widths = (np.quantile(np.abs(own), 0.9, axis=0) + 1e-3).round(DIGITS)
    trained_one = replace(draft, widths=widths)
    held, ends = features[1::2], _compress(outcomes[1::2], draft.scale)
    excesses = []
    for moment in range(moments):
        predicted, sizes = trained_one.predictions(held[:, moment], moment)
        excesses.append((predicted - ends) / sizes)
    return replace(trained_one, excesses=_rounded_up(np.stack(excesses, axis=1)))


def _rounded_up(values: Floats) -> Floats:
    """Rounded to the stored decimals, upwards: a bound may only become lower by it."""
    return np.asarray(np.ceil(values * 10**DIGITS) / 10**DIGITS)


def _compress(values: Floats, scale: float) -> Floats:
    return np.asarray(np.arcsinh(values / scale), dtype=np.float64)
