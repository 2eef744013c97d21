"""Perceptions that replace a network's estimate by the truth or by degraded truth.

The paper localises faults in this way: the network is replaced by the ground truth and the
counterexample is tested again (section "Error analysis and debugging"). Here a single estimate may
also be replaced, delayed, or disturbed by noise. The substitution is selected by a word:

==========================  ====================================================================
``as-recorded``             the unchanged network (control)
``truth``                   a perfect estimate
``truth-heading``           the network's cross-track error with the true heading error
``truth-cte``               the network's heading error with the true cross-track error
``delayed:SECONDS``         the network's estimate, delayed
``truth-delayed:SECONDS``   the truth, delayed
``noisy:SIGMA_M``           the truth with correlated noise on the cross-track error
==========================  ====================================================================

Unlike others, these perceptions may have state: each is made for one run and evaluated once per
control step.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.perception.perception import GroundTruth, Perception
from taxinet_ros.core.rig.rig import Rig
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.types import NO_ESTIMATE, NS_PER_S, TrackingError, rate_of
from taxinet_ros.errors import UsageError

AS_RECORDED, TRUTH, TRUTH_HEADING, TRUTH_CTE = (
    'as-recorded', 'truth', 'truth-heading', 'truth-cte',
)
_PLAIN = (AS_RECORDED, TRUTH, TRUTH_HEADING, TRUTH_CTE)
_DELAYED, _TRUTH_DELAYED, _NOISY = 'delayed', 'truth-delayed', 'noisy'
_AMOUNTS = {_DELAYED: 30.0, _TRUTH_DELAYED: 30.0, _NOISY: 20.0}
"""Words with an amount, and its maximum: seconds, seconds, metres."""

KNOWN = (*_PLAIN, 'delayed:SECONDS', 'truth-delayed:SECONDS', 'noisy:SIGMA_M')
"""Valid substitutions."""

NOISE_TIME_S = 1.0
"""Correlation time of the noise [s]: about how long camera frames stay similar while taxiing.

White noise hardly disturbs a steering law that averages over many frames."""

_STEP_S = CONTROL_PERIOD_NS / NS_PER_S


@dataclass(frozen=True, kw_only=True, slots=True)
class Substitution:
    """Replacement of a network's estimate.

    Attributes:
        kind: the word without its amount.
        amount: delay [s] or standard deviation [m]; 0 if the kind has none.
    """

    kind: str
    amount: float = 0.0

    @property
    def word(self) -> str:
        """Text form; equal substitutions have equal words."""
        return f'{self.kind}:{self.amount:g}' if self.kind in _AMOUNTS else self.kind


def parse_substitution(text: str, periods_s: Iterable[float] = (_STEP_S,)) -> Substitution:
    """Parse a substitution; see :data:`KNOWN`.

    Args:
        text: the text.
        periods_s: control periods of the runs [s].

    Raises:
        UsageError: unknown word; an amount that is missing or out of range; or a delay that is not
            a whole number of control steps.
    """
    kind, colon, rest = (part.strip() for part in text.partition(':'))
    if kind in _PLAIN and not colon:
        return Substitution(kind=kind)
    if kind not in _AMOUNTS:
        raise UsageError(f'substitution {text}: unknown; known: {", ".join(KNOWN)}')
    unit = 'm' if kind == _NOISY else 's'
    try:
        amount = float(rest)
    except ValueError:
        amount = math.nan
    if not 0 < amount <= _AMOUNTS[kind]:
        most = f'{_AMOUNTS[kind]:g} {unit}'
        raise UsageError(
            f'substitution {text}: needs an amount above 0 up to {most}, as in {kind}:0.5'
        )
    for period_s in () if kind == _NOISY else periods_s:
        _check_delay(text, amount, period_s)
    # The text form has six digits; round the amount so that both are equal.
    return Substitution(kind=kind, amount=float(f'{amount:g}'))


def _check_delay(text: str, delay_s: float, period_s: float) -> None:
    steps = delay_s / period_s
    if abs(steps - round(steps)) > 1e-6:
        raise UsageError(f'substitution {text}: a delay has to be a multiple of {period_s:g} s')


def substituted(
    substitution: Substitution, network: Perception, seed: Sequence[int],
    period_ns: int = CONTROL_PERIOD_NS,
) -> Perception:
    """Create the perception for one run.

    Args:
        substitution: replacement of the network's estimate.
        network: the perception whose failure is analysed.
        seed: seed of the noise; equal seeds give equal noise.
        period_ns: control period of the run [ns].

    Raises:
        UsageError: a delay is not a whole number of control steps.
    """
    period_s = 1 / rate_of(period_ns)
    kind, amount = substitution.kind, substitution.amount
    if kind == AS_RECORDED:
        return network
    if kind == TRUTH:
        return GroundTruth()
    if kind in (TRUTH_HEADING, TRUTH_CTE):
        return HalfTruth(network, cte=kind == TRUTH_CTE)
    if kind == _NOISY:
        return NoisyTruth(amount, seed, period_s)
    return Delayed(network if kind == _DELAYED else GroundTruth(), amount, period_s)


class HalfTruth(Perception):
    """A network with one of its two estimates replaced by the truth."""

    def __init__(self, network: Perception, *, cte: bool) -> None:
        """Replace the cross-track error if ``cte``, else the heading error."""
        self.word = TRUTH_CTE if cte else TRUTH_HEADING
        self.fingerprint = network.fingerprint
        self.needs_image, self.needs_sensors = network.needs_image, network.needs_sensors
        self._network = network
        self._cte = cte

    def begin(self, rig: Rig | None = None) -> None:
        """Reset the network."""
        self._network.begin(rig)

    def sense(self, measured: Measured) -> None:
        """Pass on what the sensors deliver."""
        self._network.sense(measured)

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Combine the network's estimate with the truth; invalid if either is missing."""
        seen = self._network.estimate(image, truth)
        if truth is None or not seen.usable:
            return NO_ESTIMATE
        if self._cte:
            return TrackingError(cte_m=truth.cte_m, he_rad=seen.he_rad)
        return TrackingError(cte_m=seen.cte_m, he_rad=truth.he_rad)


class Delayed(Perception):
    """Delayed estimates of another perception; its first estimate until the delay has passed."""

    def __init__(self, perception: Perception, delay_s: float, period_s: float = _STEP_S) -> None:
        """``delay_s``: delay [s], a whole number of control steps, each ``period_s`` [s]."""
        _check_delay(f'delayed:{delay_s:g}', delay_s, period_s)
        self.word = f'{perception.word} {delay_s:g} s ago'
        self.fingerprint = perception.fingerprint
        self.needs_image, self.needs_sensors = perception.needs_image, perception.needs_sensors
        self._perception = perception
        self._estimates: deque[TrackingError] = deque(maxlen=round(delay_s / period_s) + 1)

    def begin(self, rig: Rig | None = None) -> None:
        """Reset the perception and clear the buffer."""
        self._perception.begin(rig)
        self._estimates.clear()

    def sense(self, measured: Measured) -> None:
        """Pass on what the sensors deliver."""
        self._perception.sense(measured)

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return the oldest estimate not older than the delay."""
        self._estimates.append(self._perception.estimate(image, truth))
        return self._estimates[0]


class NoisyTruth(Perception):
    """The truth with correlated noise on the cross-track error; the heading error is exact.

    The noise is normal with mean 0 and the given standard deviation from the first step on; its
    autocorrelation falls to 1/e in :data:`NOISE_TIME_S` (Ornstein-Uhlenbeck process, sampled
    exactly: Gillespie, Physical Review E 54, 1996).
    """

    fingerprint = ''
    needs_image = False

    def __init__(self, sigma_m: float, seed: Sequence[int], period_s: float = _STEP_S) -> None:
        """Draw the first error.

        Args:
            sigma_m: standard deviation [m].
            seed: seed of the noise, integers >= 0.
            period_s: control period [s].
        """
        self.word = f'truth with noise of {sigma_m:g} m'
        self._random = np.random.default_rng(seed)
        self._sigma_m = sigma_m
        self._keep = math.exp(-period_s / NOISE_TIME_S)
        self._error_m = sigma_m * self._random.standard_normal()

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """Return the truth plus the noise of this step."""
        error_m = self._error_m
        fresh = math.sqrt(1 - self._keep**2) * self._sigma_m
        self._error_m = self._keep * error_m + fresh * self._random.standard_normal()
        if truth is None or not truth.usable:
            return NO_ESTIMATE
        return TrackingError(cte_m=truth.cte_m + error_m, he_rad=truth.he_rad)
