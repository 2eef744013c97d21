"""Learned distributions of searches: store as ``learned.json``, read, and count the failures.

A sampler's histograms are regularised towards the program's prior, so neither they nor their mean
are unbiased estimates. The share of failures in a bin is estimated from the failures themselves,
weighted by the program's density; they are stored with the histograms.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import typed
from taxinet_ros.files.sealed_json import read_sealed, sealed_text
from taxinet_ros.samplers.sampler import Probabilities
from taxinet_ros.scenes.search_space import Choice
from taxinet_ros.trials.rates import CONFIDENCE, TAIL

LEARNED_NAME = 'learned.json'

@dataclass(frozen=True, kw_only=True, slots=True)
class Evidence:
    """The failures of one search in which a choice was active.

    Attributes:
        amounts: sum of their weights, in each of the choice's bins.
        squares: sum of the squares of their weights, in each bin.
        heaviest: greatest weight that a failure can have; None if there is no bound.
    """

    amounts: tuple[float, ...]
    squares: tuple[float, ...]
    heaviest: float | None

    @property
    def failures(self) -> float:
        """Effective number of failures drawn by the program itself (Kish, 1965)."""
        return sum(self.amounts) ** 2 / sum(self.squares) if sum(self.squares) else 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class LearnedResult:
    """The learned distribution of one search.

    Attributes:
        facts: program, sampler, perception, seed and number of runs of the search.
        choices: the searched choices.
        probabilities: the sampler's probabilities of their bins, by name of the dimension.
        evidence: by name of the dimension; empty if the weights of the runs are unknown.
    """

    facts: Mapping[str, Any]
    choices: tuple[Choice, ...]
    probabilities: Probabilities
    evidence: Mapping[str, Evidence] = field(default_factory=dict)

    def to_json(self) -> str:
        """Text of ``learned.json``."""
        dimensions = [
            {
                **choice.to_json(), 'probabilities': list(self.probabilities[name]),
                'evidence': dataclasses.asdict(self.evidence[name]) if self.evidence else None,
            }
            for choice in self.choices if (name := choice.dimension.name) in self.probabilities
        ]
        values = {'facts': dict(self.facts), 'dimensions': dimensions}
        return sealed_text(values)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the learned distribution of the search in ``folder``.

        Raises:
            UsageError: there is none, or it cannot be read.
        """
        path = folder / LEARNED_NAME
        try:
            values = read_sealed(path).values
            dimensions = values['dimensions']
            names = {field.name for field in dataclasses.fields(Choice)}
            choices = tuple(
                typed(Choice, {name: one[name] for name in names}) for one in dimensions
            )
            return cls(
                facts=dict(values['facts']), choices=choices,
                probabilities={
                    choice.dimension.name: tuple(map(float, dimension['probabilities']))
                    for choice, dimension in zip(choices, dimensions, strict=True)
                },
                evidence={
                    choice.dimension.name: typed(Evidence, evidence)
                    for choice, dimension in zip(choices, dimensions, strict=True)
                    if (evidence := dimension['evidence'])
                },
            )
        except FileNotFoundError as error:
            raise UsageError(
                f'{path}: no such file; name the folder of a search with ce or mab'
            ) from error
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise UsageError(f'{path}: cannot be read; resume the search to rewrite it') from error


class Share(NamedTuple):
    """A share of the failures under the program, with its 95 % interval.

    Where it is unknown, the share is NaN; where no interval is, it is [0, 1].
    """

    share: float
    low: float
    high: float


def share_of_failures(
    searches: Sequence[LearnedResult], choice: Choice, low: float, high: float
) -> Share:
    """The share of the failures at values in [low, high]; within a bin the program's law applies.

    Each end is Clopper and Pearson's, with weighted counts (Fay and Feuer, Statistics in
    Medicine 16, 1997): a further failure of the greatest possible weight is added on one
    side, and the beta distribution has the mean and variance of the share then. Within one
    search that variance is the sum of the squared deviations of the weighted failures, which
    are those of a martingale, however the sampler learns; so it is enough for several. If they
    clearly differ by more than it explains, their spread counts, with Student's quantile for
    their small number (as clusters: Korn and Graubard, Survey Methodology 24, 1998).

    Args:
        searches: searches that differ only in their seed, all with evidence.
        choice: the choice whose values are compared.
        low: lower end.
        high: upper end.

    Raises:
        UsageError: the choice has no values to compare.
    """
    ones = np.eye(len(choice.dimension.prior)).tolist()
    inside = np.array([choice.probability_within(low, high, tuple(one)) for one in ones])
    evidence = [search.evidence[choice.dimension.name] for search in searches]
    amounts = np.array([each.amounts for each in evidence])
    squares = np.sum([each.squares for each in evidence], axis=0)
    hits, totals = amounts @ inside, amounts.sum(axis=1)
    if not squares.any():
        return Share(share=math.nan, low=0.0, high=1.0)
    within = _Part(float(hits.sum()), float(squares @ inside))
    without = _Part(float((amounts @ (1 - inside)).sum()), float(squares @ (1 - inside)))
    share = within.amount / (within.amount + without.amount)
    bounds = [each.heaviest for each in evidence]
    if None in bounds:
        return Share(share=share, low=0.0, high=1.0)
    heaviest = max(each for each in bounds if each is not None)
    variance = _variance(within, without)
    wider = _wider(hits - share * totals, variance)
    return Share(
        share=share, low=1 - _upper(without, within, heaviest, wider),
        high=_upper(within, without, heaviest, wider),
    )


class _Part(NamedTuple):
    """Weighted failures in a part of a choice's values: sums of weights and of their squares."""

    amount: float
    squares: float


def _variance(within: _Part, without: _Part) -> float:
    """Variance of the weights within, less the share's part of all (linearised)."""
    share = within.amount / (within.amount + without.amount)
    return within.squares * (1 - share) ** 2 + without.squares * share**2


def _wider(deviations: npt.NDArray[np.float64], variance: float) -> float:
    """Factor of the variance by which several searches differ more than it explains, 1 or more."""
    from scipy.stats import chi2, norm, t

    more = len(deviations) - 1
    if not more or not variance:
        return 1.0
    spread = float(deviations @ deviations) * len(deviations) / (more * variance)
    if spread * more <= chi2.ppf(CONFIDENCE, more):
        return 1.0
    return spread * float(t.ppf(1 - TAIL, more) / norm.ppf(1 - TAIL)) ** 2


def _upper(within: _Part, without: _Part, heaviest: float, wider: float) -> float:
    """Upper end of the share within; ``wider`` multiplies the variance."""
    from scipy.special import betaincinv

    if without.amount <= 0:
        return 1.0
    within = _Part(within.amount + heaviest, within.squares + heaviest**2)
    total = within.amount + without.amount
    share = within.amount / total
    failures = share * (1 - share) * total**2 / (wider * _variance(within, without))
    return float(betaincinv(share * failures, (1 - share) * failures, 1 - TAIL))
