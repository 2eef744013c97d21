"""How many runs a claim takes: "at least 99.9 % of the runs satisfy, with 95 % confidence".

Exact binomial reasoning (Clopper and Pearson, Biometrika 26, 1934): ``n`` runs with ``k`` failures
show that failures are no more frequent than a limit if a system exactly at the limit would have
failed so seldom, ``k`` times or fewer, with a probability of at most 1 - confidence. That is the
one-sided bound of Clopper and Pearson at or below the limit. It holds for runs drawn independently
by the program itself, in a number fixed beforehand and judged once; what may be said when somebody
looks earlier, or adds runs later, is :func:`further_runs`, by the bounds that hold at any number of
runs (:mod:`.rates`).

With the true rate the number of failures is binomial, and so is the chance that a plan succeeds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import log_evidence_below

MOST_RUNS = 10**9
"""Largest plan; beyond it, bisection and binomial sums lose their digits."""
MOST_FURTHER = 10**8
"""Most further runs that are looked for."""
_MOST_FAILURES = 1 << 14


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """A number of runs and how many of them may fail.

    Attributes:
        runs: fewest runs with which the claim holds if no more than ``failures`` fail.
        failures: allowed failures.
        chance: probability of that at the assumed true rate; None without one.
    """

    runs: int
    failures: int
    chance: float | None = None


def check_claim(limit: float, confidence: float) -> None:
    """Check a claim about a share of failures.

    Raises:
        UsageError: no number of runs shows it, or it says nothing.
    """
    if not 0 < limit < 1:
        what = 'no number of runs shows that' if limit <= 0 else 'it claims nothing'
        raise UsageError(f'plan: at most {limit:g} of the runs fail: {what}')
    if not 0.5 <= confidence < 1:
        raise UsageError(f'confidence {confidence:g}: needs to be within 0.5..1')


def fewest_runs(limit: float, confidence: float, failures: int = 0) -> int:
    """Fewest runs of which ``failures`` may fail, to claim that no more than ``limit`` do.

    >>> fewest_runs(0.001, 0.95)
    2995

    Raises:
        UsageError: a bad claim, or more than :data:`MOST_RUNS`.
    """
    check_claim(limit, confidence)
    if failures < 0:
        raise UsageError(f'failures {failures}: needs to be 0 or more')
    return int(_fewest(limit, confidence, np.array([failures]))[0])


def chance(plan: Plan, truth: float) -> float:
    """Probability that no more than the allowed failures occur at a true rate of failures."""
    return float(_at_most(np.array([plan.failures]), np.array([plan.runs]), truth)[0])


def plan_with_power(limit: float, confidence: float, truth: float, power: float) -> Plan:
    """The shortest plan that succeeds with a probability of at least ``power``.

    Args:
        limit: largest share of failures to be shown.
        confidence: of the claim.
        truth: assumed true share of failures.
        power: wanted chance of success.

    Raises:
        UsageError: a bad claim, a true rate that does not meet it, or too close to it for any
            realistic number of runs.
    """
    check_claim(limit, confidence)
    if not 0 < power < 1:
        raise UsageError(f'power {power:g}: needs to be within 0..1, without its ends')
    if not 0 <= truth < limit:
        raise UsageError(
            f'plan: a system that fails in {truth:g} of the runs does not meet the claim of '
            f'{limit:g}; only one that is better can show it'
        )
    low, high = 0, 32
    most = np.array([_MOST_FAILURES])
    reachable = _at_most(most, _fewest(limit, confidence, most), truth)[0] >= power
    while reachable and low <= _MOST_FAILURES:
        failures = np.arange(low, high)
        runs = _fewest(limit, confidence, failures)
        chances = _at_most(failures, runs, truth)
        enough = np.flatnonzero(chances >= power)
        if len(enough):
            first = int(enough[0])
            return Plan(
                runs=int(runs[first]), failures=int(failures[first]), chance=float(chances[first])
            )
        low, high = high, min(4 * high, _MOST_FAILURES + 1)
    raise UsageError(
        f'plan: {truth:g} is too close to the claim of {limit:g}: more than {_MOST_FAILURES:,} '
        'failures would have to be seen'
    )


def further_runs(
    runs: int, failures: int, limit: float, confidence: float, more_failures: int
) -> int | None:
    """Fewest further runs to a claim, of which ``more_failures`` may fail; None if too many.

    By the bound that holds at any number of runs, since whoever sees the first runs and goes on
    chooses the number by the result.

    Args:
        runs: number of runs so far.
        failures: number of failures among them.
        limit: largest share of failures to be shown.
        confidence: of the claim.
        more_failures: failures allowed among the further runs.
    """
    bad = failures + more_failures
    return _first(
        lambda more: _shown(bad, runs + more - bad, limit, confidence), more_failures,
    )


def further_plan(
    runs: int, failures: int, limit: float, confidence: float, *, truth: float, power: float
) -> Plan | None:
    """Further runs after which the claim holds with a chance of at least ``power``.

    Bounds as for :func:`further_runs`. The chance is that of the look at the last of these runs;
    who looks in between passes no more rarely.

    Args:
        runs: number of runs so far.
        failures: number of failures among them.
        limit: largest share of failures to be shown.
        confidence: of the claim.
        truth: assumed true share of failures.
        power: wanted chance.

    Returns:
        Further runs and the failures allowed among them; None if the true share does not meet the
        claim, or for too many runs.
    """
    if truth >= limit:
        return None

    def plan(more: int) -> Plan:
        low, high = -1, more + 1  # most failures that still show it
        while high - low > 1:
            middle = (low + high) // 2
            bad = failures + middle
            shown = _shown(bad, runs + more - bad, limit, confidence)
            low, high = (middle, high) if shown else (low, middle)
        found = Plan(runs=more, failures=low)
        return Plan(runs=more, failures=low, chance=chance(found, truth) if low >= 0 else 0.0)

    more = _first(lambda more: (plan(more).chance or 0.0) >= power, 0)
    return None if more is None else plan(more)


def _shown(bad: int, good: int, limit: float, confidence: float) -> bool:
    """Whether runs show it at any number of runs: the test of :func:`.rates.anytime_bounds`."""
    return log_evidence_below(bad, good, limit) >= -math.log(1 - confidence)


def _first(enough: Callable[[int], bool], low: int) -> int | None:
    """Smallest number from ``low`` on that is enough; None if above :data:`MOST_FURTHER`."""
    if enough(low):
        return low
    high = max(2 * low, 16)
    while not enough(high):
        low, high = high, 2 * high
        if high > MOST_FURTHER:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def _fewest(
    limit: float, confidence: float, failures: NDArray[np.int64]
) -> NDArray[np.int64]:
    """:func:`fewest_runs` for several numbers of failures."""
    tail = 1 - confidence
    # With k + 1 runs, more than k failures need all of them to fail.
    low = failures.astype(np.int64)
    high = np.maximum(4 * (failures + 1), 16).astype(np.int64)
    while (short := _at_most(failures, high, limit) > tail).any():
        low, high = np.where(short, high, low), np.where(short, 4 * high, high)
        if high.max() > 4 * MOST_RUNS:
            raise UsageError(
                f'plan: at most {limit:g} of the runs fail: takes more than {MOST_RUNS:,} runs'
            )
    while (high - low).max() > 1:
        middle = (low + high) // 2
        enough = _at_most(failures, middle, limit) <= tail
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high


def _at_most(
    failures: NDArray[np.int64], runs: NDArray[np.int64], truth: float
) -> NDArray[np.float64]:
    """Probability of at most so many failures; both (N,)."""
    from scipy.special import betaincc

    if truth <= 0:
        return np.ones(len(failures))
    certain = failures >= runs
    # 1 - I_truth(k + 1, n - k): the complement keeps the digits of small rates.
    found = betaincc(failures + 1.0, np.where(certain, 1, runs - failures), truth)
    return np.where(certain, 1.0, found)
