"""Whether a retrained network replaces the one before it, judged on the same unseen scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy.stats import binom

from taxinet_ros.analysis.paired_arms import Comparison, compare
from taxinet_ros.analysis.plain_values import plain_values
from taxinet_ros.campaign.rates import rate
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.scenario import CLOUDS

INCUMBENT, CANDIDATE = 'incumbent', 'candidate'

_DISTANCE_M = (0, 400, 800, 1200, 1600)
_HOURS = (6, 9, 12, 15)


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What the runs say.

    Attributes:
        accepted: whether the candidate is the network from now on.
        why: in words, what decided.
        pairs: scenes judged with both.
        failed_before, failed_now: of them, with the incumbent and with the candidate.
        only_before, only_now: failed with one of them only.
        failures_p: two-sided exact McNemar test of whether they fail equally often.
        rho_change: typical change of the headline's robustness [m, or as its predicate].
        rho_low, rho_high: its 95 % interval.
        rho_p: two-sided Wilcoxon test of whether there is any.
        off_before, off_now: runs that left the runway.
        satisfied_low: lower end of the candidate's 95 % Clopper-Pearson interval.
        worse: where on the runway, in the day or under which sky it fails more often, beyond doubt.
    """

    accepted: bool
    why: str
    pairs: int
    failed_before: int
    failed_now: int
    only_before: int
    only_now: int
    failures_p: float
    rho_change: float
    rho_low: float
    rho_high: float
    rho_p: float
    off_before: int
    off_now: int
    satisfied_low: float
    worse: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values, None where there is no number."""
        return plain_values(asdict(self))


def decide(before: Sequence[RunRow], now: Sequence[RunRow], alpha: float) -> Decision:
    """Compare the runs of two networks over the scenes that were judged with both.

    The candidate is accepted if it fails less often, or fails no more often and keeps to the
    centreline better (robustness), at a level of ``alpha``; but not if it leaves the runway more
    often, or fails more often, beyond doubt, on some stretch, at some hour or under some sky.

    Args:
        before: runs of the incumbent.
        now: runs of the candidate, of the same scenes.
        alpha: probability, for either reason, of accepting a network that is no better.
    """
    found = compare(INCUMBENT, before, CANDIDATE, now)
    satisfied, off, rho = found.satisfied, found.off_runway, found.rho
    worse = _worse_places(found, alpha)
    why, accepted = _verdict(found, worse, alpha)
    return Decision(
        accepted=accepted, why=why, pairs=satisfied.pairs,
        failed_before=satisfied.pairs - satisfied.first,
        failed_now=satisfied.pairs - satisfied.second,
        only_before=satisfied.only_second, only_now=satisfied.only_first,
        failures_p=satisfied.p_value, rho_change=rho.change.value, rho_low=rho.change.low,
        rho_high=rho.change.high, rho_p=rho.p_value, off_before=off.first, off_now=off.second,
        satisfied_low=rate(satisfied.second, satisfied.pairs).low if found.pairs else 0.0,
        worse=worse,
    )


def _verdict(found: Comparison, worse: tuple[str, ...], alpha: float) -> tuple[str, bool]:
    satisfied, off, rho = found.satisfied, found.off_runway, found.rho
    if off.second > off.first:
        return f'leaves the runway more often ({off.second} runs, not {off.first})', False
    if worse:
        return f'fails more often {", ".join(worse)}', False
    if satisfied.second > satisfied.first and satisfied.p_value <= alpha:
        return f'fails less often (p {satisfied.p_value:.2g})', True
    if satisfied.second < satisfied.first:
        return 'fails more often', False
    if rho.change.value > 0 and rho.p_value <= alpha:
        return f'fails no more often and keeps nearer to the centreline (p {rho.p_value:.2g})', True
    return 'not better beyond doubt', False


def _worse_places(found: Comparison, alpha: float) -> tuple[str, ...]:
    """Bins in which the candidate fails more often; the level is shared among all of them."""
    bins: dict[str, list[int]] = {}
    for one, other in found.pairs:
        change = (other.outcome is Outcome.FAIL) - (one.outcome is Outcome.FAIL)
        for name in _bins(one):
            bins.setdefault(name, []).append(change)
    level = alpha / max(1, len(bins))
    return tuple(sorted(name for name, changes in bins.items() if _grew(changes) <= level))


def _grew(changes: Sequence[int]) -> float:
    """One-sided exact McNemar test of whether failures became more."""
    more, fewer = changes.count(1), changes.count(-1)
    return float(binom.sf(more - 1, more + fewer, 0.5)) if more > fewer else 1.0


def _bins(row: RunRow) -> tuple[str, ...]:
    assert row.distance is not None  # a judged run has a scene
    assert row.time_of_day is not None
    assert row.clouds in CLOUDS
    metres, hour = _floor(row.distance, _DISTANCE_M), _floor(row.time_of_day, _HOURS)
    sky = 'in rain' if row.rain else f'under {row.clouds}'
    return (f'from {metres} m', f'from {hour} h', sky)


def _floor(value: float, starts: tuple[int, ...]) -> int:
    return max((start for start in starts if start <= value), default=starts[0])
