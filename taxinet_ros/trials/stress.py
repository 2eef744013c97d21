"""Adaptive stress testing as a search: what has no likelihood is refused; the likeliest failure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import SAMPLERS
from taxinet_ros.samplers.stress import deviations
from taxinet_ros.scenes.search_space import SearchSpace
from taxinet_ros.trials.record.row import RunRow

_HARMLESS = ('(overridden)', '(without effect)')
_MOST_NAMED = 12


@dataclass(frozen=True, kw_only=True, slots=True)
class LikeliestFailure:
    """The failure that the program's normal choices make likeliest, of those found.

    Attributes:
        row: its run.
        deviations: the choices in standard deviations from their means, by name.
    """

    row: RunRow
    deviations: dict[str, float]

    @property
    def sigma(self) -> float:
        """Distance from the means [standard deviations]: the root of the sum of squares."""
        return float(np.linalg.norm(list(self.deviations.values())))

    @property
    def log_likelihood(self) -> float:
        """Natural logarithm of its likelihood, less that of the means, the likeliest path."""
        return -self.sigma**2 / 2

    def words(self) -> list[str]:
        """Lines on it, with the choices that make it unlikely first."""
        named = sorted(self.deviations.items(), key=lambda each: (-abs(each[1]), each[0]))
        more = len(named) - _MOST_NAMED
        choices = ', '.join(f'{name} {value:+.2f}' for name, value in named[:_MOST_NAMED])
        mean = self.log_likelihood / len(named)
        return [
            f'likeliest failure found: run {self.row.index}, {self.sigma:.2f} sigma from the '
            f'means, log-likelihood {self.log_likelihood:.2f} beside theirs ({mean:.2f} a choice)',
            f'  in sigma: {choices}' + (f', and {more} more' if more > 0 else ''),
        ]

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            'run_id': self.row.run_id, 'sigma': self.sigma,
            'log_likelihood': self.log_likelihood, 'deviations': self.deviations,
        }


def likeliest_failure(sampler: str, rows: Iterable[RunRow]) -> LikeliestFailure | None:
    """The likeliest failed run; None without a failure, or of a sampler that has no likelihoods.

    Args:
        sampler: word of the sampler that chose the runs; '' if there was none.
        rows: the runs; the first counts of those that are equally likely.
    """
    if sampler not in SAMPLERS or not SAMPLERS[sampler].by_likelihood:
        return None
    found = [
        LikeliestFailure(row=row, deviations=dict(zip(
            row.point, map(float, deviations(tuple(row.point.values()))), strict=True
        )))
        for row in rows if row.outcome is Outcome.FAIL
    ]
    return min(found, key=lambda one: one.sigma, default=None)


def check_likelihood(sampler: str, space: SearchSpace) -> None:
    """Refuse what is drawn without a likelihood, if the sampler searches by it.

    Raises:
        UsageError: a choice is not normal, or something is drawn beside the search.
    """
    if not SAMPLERS[sampler].by_likelihood:
        return
    for choice in space.searched:
        if choice.law is None or choice.law.kind != 'Normal':
            raise UsageError(
                f'sampler {sampler}: {choice.dimension.name} is no Normal(mean, stddev), so none '
                'of its values is likelier than others; draw it as one, or set it'
            )
    for name in space.unsearched:
        if not name.endswith(_HARMLESS):
            raise UsageError(
                f'sampler {sampler}: {name} is drawn, but not searched, so a path would not fail '
                'again; draw it as Normal(mean, stddev), or leave it out'
            )
    if not space.searched:
        raise UsageError(
            f'sampler {sampler}: the program draws no disturbance; write one, such as '
            "param 'steering_bias_deg@5' = Normal(0, 1)"
        )
